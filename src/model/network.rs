//! A small multilayer perceptron: rows of inputs to rows of outputs, and its gradients.
//!
//! Hidden layers are leaky rectified linear units; the inputs are concatenated again in front of one of them (a skip
//! connection, ARS-GS). Products of matrices follow the engine's contract (a fixed order of sums, no contraction), so
//! results are the same bits for any number of threads and any set of instructions; crates for such products promise
//! neither.

use crate::vectorised;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use rayon::prelude::*;

/// Columns of a tile.
const TILE: usize = 16;
/// Rows of a tile.
const ROWS: usize = 4;
/// Rows of inputs that go through all layers at once; their gradients are summed by blocks, in order.
const BLOCK: usize = 256;
/// Slope of the rectifier below zero: small, but a unit that is always off still gets a gradient.
const NEGATIVE_SLOPE: f32 = 0.01;

/// Shape of a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Network {
    /// Inputs per row.
    pub inputs: usize,
    /// Units of a hidden layer.
    pub width: usize,
    /// Number of hidden layers, at least one.
    pub hidden: usize,
    /// Outputs per row.
    pub outputs: usize,
}

/// One layer: weights `[input][output]`, then a bias for each output.
#[derive(Debug, Clone, Copy)]
struct Layer {
    inputs: usize,
    outputs: usize,
    /// Start of the layer's weights among those of the network.
    from: usize,
    /// True if the network's inputs are concatenated to the previous layer's outputs.
    joined: bool,
}

/// `out[row][col] += Σ_k a[row·row_step + k·k_step] b[k·cols + col]`, `cols` a multiple of the tile's.
struct Product<'a> {
    a: &'a [f32],
    row_step: usize,
    k_step: usize,
    inner: usize,
    b: &'a [f32],
}

/// Adds `R` rows of one tile. The sums stay in registers: every index into them is known when this is compiled.
#[inline(always)]
fn tile<const R: usize>(product: &Product, out: &mut [f32], cols: usize, row: usize, col: usize) {
    let Product {
        a,
        row_step,
        k_step,
        inner,
        b,
    } = *product;
    let mut sums = [[0.0f32; TILE]; R];
    for k in 0..inner {
        let line: &[f32; TILE] = b[k * cols + col..k * cols + col + TILE].try_into().expect("a tile");
        for r in 0..R {
            let x = a[(row + r) * row_step + k * k_step];
            for c in 0..TILE {
                sums[r][c] += x * line[c];
            }
        }
    }
    for r in 0..R {
        let at = (row + r) * cols + col;
        let line: &mut [f32; TILE] = (&mut out[at..at + TILE]).try_into().expect("a tile");
        for c in 0..TILE {
            line[c] += sums[r][c];
        }
    }
}

vectorised! {
    fn multiply(product: &Product, out: &mut [f32], cols: usize) {
        let rows = out.len() / cols;
        for col in (0..cols).step_by(TILE) {
            let mut row = 0;
            while row + ROWS <= rows {
                tile::<ROWS>(product, out, cols, row, col);
                row += ROWS;
            }
            while row < rows {
                tile::<1>(product, out, cols, row, col);
                row += 1;
            }
        }
    }
}

/// Columns of a matrix in memory, a multiple of a tile's.
fn padded(cols: usize) -> usize {
    cols.next_multiple_of(TILE)
}

/// Weights as products read them.
struct Prepared {
    layers: Vec<Layer>,
    /// Per layer `[input][padded output]` and the bias.
    forward: Vec<(Vec<f32>, Vec<f32>)>,
    /// Per layer `[output][padded input]`.
    backward: Vec<Vec<f32>>,
}

/// A forward pass over some rows, kept for the backward pass.
pub struct ForwardPass {
    network: Network,
    prepared: Prepared,
    blocks: Vec<LayerInputs>,
    rows: usize,
    /// Outputs, `[row][output]`.
    pub outputs: Vec<f32>,
}

/// Activations of a block of rows: the inputs of every layer, padded, and the outputs of the last.
struct LayerInputs {
    inputs: Vec<Vec<f32>>,
    out: Vec<f32>,
}

impl Network {
    fn layers(&self) -> Vec<Layer> {
        let mut layers = Vec::new();
        let mut from = 0;
        for n in 0..=self.hidden {
            // In front of the second hidden layer (ARS-GS).
            let joined = n == 1 && self.hidden > 1;
            let before = if n == 0 { self.inputs } else { self.width };
            let inputs = before + if joined { self.inputs } else { 0 };
            let outputs = if n == self.hidden { self.outputs } else { self.width };
            layers.push(Layer {
                inputs,
                outputs,
                from,
                joined,
            });
            from += (inputs + 1) * outputs;
        }
        layers
    }

    /// Number of trained weights, biases included.
    pub fn weights(&self) -> usize {
        self.layers().iter().map(|l| (l.inputs + 1) * l.outputs).sum()
    }

    /// Initial weights: hidden layers keep the variance of their inputs (He et al. 2015), the last layer is scaled by
    /// `output_scale`.
    pub fn initial(&self, seed: u64, output_scale: f32) -> Vec<f32> {
        let mut random = Pcg32::seed_from_u64(seed);
        let mut weights = vec![0.0; self.weights()];
        let layers = self.layers();
        for (n, layer) in layers.iter().enumerate() {
            let scale = (6.0 / layer.inputs as f32).sqrt() * if n + 1 == layers.len() { output_scale } else { 1.0 };
            for weight in &mut weights[layer.from..layer.from + layer.inputs * layer.outputs] {
                *weight = scale * (2.0 * random.random::<f32>() - 1.0);
            }
        }
        weights
    }

    fn prepare(&self, weights: &[f32]) -> Prepared {
        let layers = self.layers();
        let (mut forward, mut backward) = (Vec::new(), Vec::new());
        for layer in &layers {
            let (wide, tall) = (padded(layer.outputs), padded(layer.inputs));
            let (mut across, mut back) = (vec![0.0; layer.inputs * wide], vec![0.0; layer.outputs * tall]);
            for i in 0..layer.inputs {
                for o in 0..layer.outputs {
                    let weight = weights[layer.from + i * layer.outputs + o];
                    across[i * wide + o] = weight;
                    back[o * tall + i] = weight;
                }
            }
            let mut bias = vec![0.0; wide];
            let at = layer.from + layer.inputs * layer.outputs;
            bias[..layer.outputs].copy_from_slice(&weights[at..at + layer.outputs]);
            forward.push((across, bias));
            backward.push(back);
        }
        Prepared {
            layers,
            forward,
            backward,
        }
    }

    /// Runs rows of `inputs` through all layers.
    fn forward_block(&self, prepared: &Prepared, inputs: &[f32]) -> LayerInputs {
        let rows = inputs.len() / self.inputs;
        let (mut activations, mut last): (Vec<Vec<f32>>, Vec<f32>) = (Vec::new(), Vec::new());
        for (n, layer) in prepared.layers.iter().enumerate() {
            let tall = padded(layer.inputs);
            let mut into = vec![0.0; rows * tall];
            for (row, line) in into.chunks_mut(tall).enumerate() {
                let own = &inputs[row * self.inputs..(row + 1) * self.inputs];
                if n == 0 {
                    line[..self.inputs].copy_from_slice(own);
                    continue;
                }
                let wide = padded(self.width);
                for (slot, x) in line.iter_mut().zip(&last[row * wide..row * wide + self.width]) {
                    *slot = if *x > 0.0 { *x } else { NEGATIVE_SLOPE * x };
                }
                if layer.joined {
                    line[self.width..self.width + self.inputs].copy_from_slice(own);
                }
            }
            let (weights, bias) = &prepared.forward[n];
            last = bias.repeat(rows);
            let product = Product {
                a: &into,
                row_step: tall,
                k_step: 1,
                inner: layer.inputs,
                b: weights,
            };
            multiply(&product, &mut last, bias.len());
            activations.push(into);
        }
        LayerInputs {
            inputs: activations,
            out: last,
        }
    }

    /// Outputs, `[row][output]`, of `inputs`, `[row][input]`.
    pub fn forward(&self, weights: &[f32], inputs: &[f32]) -> Vec<f32> {
        let prepared = self.prepare(weights);
        let wide = padded(self.outputs);
        let mut out = vec![0.0; inputs.len() / self.inputs * self.outputs];
        out.par_chunks_mut(BLOCK * self.outputs)
            .zip(inputs.par_chunks(BLOCK * self.inputs))
            .for_each(|(out, inputs)| {
                let activations = self.forward_block(&prepared, inputs);
                for (out, line) in out.chunks_mut(self.outputs).zip(activations.out.chunks(wide)) {
                    out.copy_from_slice(&line[..self.outputs]);
                }
            });
        out
    }

    /// Outputs for `inputs`, `[row][input]`, with the activations that the backward pass needs.
    pub fn forward_kept(&self, weights: &[f32], inputs: &[f32]) -> ForwardPass {
        let prepared = self.prepare(weights);
        let blocks: Vec<LayerInputs> = inputs
            .par_chunks(BLOCK * self.inputs)
            .map(|inputs| self.forward_block(&prepared, inputs))
            .collect();
        let wide = padded(self.outputs);
        let lines = blocks.iter().flat_map(|activations| activations.out.chunks(wide));
        ForwardPass {
            outputs: lines.flat_map(|line| line[..self.outputs].iter().copied()).collect(),
            rows: inputs.len() / self.inputs,
            network: *self,
            prepared,
            blocks,
        }
    }

    /// Gradients of the inputs, `[row][input]`, and of the weights, from those of the outputs, `[row][output]`.
    pub fn backward(&self, weights: &[f32], inputs: &[f32], d_outputs: &[f32]) -> (Vec<f32>, Vec<f32>) {
        self.forward_kept(weights, inputs).backward(d_outputs)
    }

    fn backward_block(
        &self,
        prepared: &Prepared,
        activations: &LayerInputs,
        d_outputs: &[f32],
        d_inputs: &mut [f32],
    ) -> Vec<f32> {
        let rows = d_outputs.len() / self.outputs;
        let mut d_weights = vec![0.0; self.weights()];
        let mut wide = padded(self.outputs);
        let mut d_out = vec![0.0; rows * wide];
        for (line, d) in d_out.chunks_mut(wide).zip(d_outputs.chunks(self.outputs)) {
            line[..self.outputs].copy_from_slice(d);
        }
        for (n, layer) in prepared.layers.iter().enumerate().rev() {
            let (into, tall) = (&activations.inputs[n], padded(layer.inputs));
            // Weights: inputs transposed times gradients.
            let mut part = vec![0.0; layer.inputs * wide];
            let product = Product {
                a: into,
                row_step: 1,
                k_step: tall,
                inner: rows,
                b: &d_out,
            };
            multiply(&product, &mut part, wide);
            for i in 0..layer.inputs {
                let at = layer.from + i * layer.outputs;
                d_weights[at..at + layer.outputs].copy_from_slice(&part[i * wide..i * wide + layer.outputs]);
            }
            let bias = layer.from + layer.inputs * layer.outputs;
            for line in d_out.chunks(wide) {
                for (slot, d) in d_weights[bias..bias + layer.outputs].iter_mut().zip(line) {
                    *slot += d;
                }
            }
            let mut d_into = vec![0.0; rows * tall];
            let product = Product {
                a: &d_out,
                row_step: wide,
                k_step: 1,
                inner: layer.outputs,
                b: &prepared.backward[n],
            };
            multiply(&product, &mut d_into, tall);
            if n == 0 || layer.joined {
                let from = if n == 0 { 0 } else { self.width };
                for (line, d) in d_inputs.chunks_mut(self.inputs).zip(d_into.chunks(tall)) {
                    line.iter_mut()
                        .zip(&d[from..from + self.inputs])
                        .for_each(|(s, d)| *s += d);
                }
            }
            if n > 0 {
                wide = padded(self.width);
                d_out = vec![0.0; rows * wide];
                for row in 0..rows {
                    for u in 0..self.width {
                        let slope = if into[row * tall + u] > 0.0 {
                            1.0
                        } else {
                            NEGATIVE_SLOPE
                        };
                        d_out[row * wide + u] = slope * d_into[row * tall + u];
                    }
                }
            }
        }
        d_weights
    }
}

impl ForwardPass {
    /// Gradients of the inputs, `[row][input]`, and of the weights, from those of the outputs, `[row][output]`.
    pub fn backward(&self, d_outputs: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let network = &self.network;
        let mut d_inputs = vec![0.0; self.rows * network.inputs];
        let parts: Vec<Vec<f32>> = d_inputs
            .par_chunks_mut(BLOCK * network.inputs)
            .zip(&self.blocks)
            .zip(d_outputs.par_chunks(BLOCK * network.outputs))
            .map(|((d_inputs, activations), d_outputs)| {
                network.backward_block(&self.prepared, activations, d_outputs, d_inputs)
            })
            .collect();
        let mut d_weights = vec![0.0f32; network.weights()];
        for part in &parts {
            d_weights.iter_mut().zip(part).for_each(|(sum, d)| *sum += d);
        }
        (d_inputs, d_weights)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: Network = Network {
        inputs: 5,
        width: 19,
        hidden: 3,
        outputs: 2,
    };

    /// The network in f64, one sum after another.
    fn plain(shape: &Network, weights: &[f64], inputs: &[f64]) -> Vec<f64> {
        let mut last: Vec<f64> = Vec::new();
        for (n, layer) in shape.layers().iter().enumerate() {
            let mut into = if n == 0 { inputs.to_vec() } else { last.clone() };
            if n > 0 {
                into.iter_mut()
                    .for_each(|x| *x = if *x > 0.0 { *x } else { f64::from(NEGATIVE_SLOPE) * *x });
            }
            if layer.joined {
                into.extend(inputs);
            }
            assert_eq!(into.len(), layer.inputs);
            let unit = |o: usize| {
                let bias = weights[layer.from + layer.inputs * layer.outputs + o];
                let product = |i: usize| into[i] * weights[layer.from + i * layer.outputs + o];
                bias + (0..layer.inputs).map(product).sum::<f64>()
            };
            last = (0..layer.outputs).map(unit).collect();
        }
        last
    }

    fn numbers(count: usize, seed: u64) -> Vec<f32> {
        let mut random = Pcg32::seed_from_u64(seed);
        (0..count).map(|_| 2.0 * random.random::<f32>() - 1.0).collect()
    }

    #[test]
    fn values_and_gradients_match_the_f64_form() {
        let rows = 2 * BLOCK + 7;
        let mut weights = SHAPE.initial(3, 1.0);
        weights
            .iter_mut()
            .zip(numbers(SHAPE.weights(), 4))
            .for_each(|(w, n)| *w += 0.1 * n);
        let (inputs, d_out) = (numbers(rows * SHAPE.inputs, 5), numbers(rows * SHAPE.outputs, 6));
        let wide = |v: &[f32]| -> Vec<f64> { v.iter().map(|&x| f64::from(x)).collect() };
        let (w, x, d) = (wide(&weights), wide(&inputs), wide(&d_out));
        let row = |x: &[f64], r: usize| x[r * SHAPE.inputs..(r + 1) * SHAPE.inputs].to_vec();
        let out = SHAPE.forward(&weights, &inputs);
        for r in 0..rows {
            for (a, b) in out[r * 2..].iter().zip(plain(&SHAPE, &w, &row(&x, r))) {
                assert!((f64::from(*a) - b).abs() < 1e-5, "{a} {b}");
            }
        }
        let (d_inputs, d_weights) = SHAPE.backward(&weights, &inputs, &d_out);
        let of_row = |w: &[f64], x: &[f64], r: usize| -> f64 {
            plain(&SHAPE, w, x).iter().zip(&d[r * 2..]).map(|(v, d)| v * d).sum()
        };
        let step = 1e-6;
        for at in (0..inputs.len()).step_by(41) {
            let (r, mut hi, mut lo) = (at / SHAPE.inputs, x.clone(), x.clone());
            hi[at] += step;
            lo[at] -= step;
            let numeric = (of_row(&w, &row(&hi, r), r) - of_row(&w, &row(&lo, r), r)) / (2.0 * step);
            assert!(
                (numeric - f64::from(d_inputs[at])).abs() < 1e-4,
                "{numeric} {}",
                d_inputs[at]
            );
        }
        let whole = |w: &[f64]| -> f64 { (0..rows).map(|r| of_row(w, &row(&x, r), r)).sum() };
        for at in (0..weights.len()).step_by(23) {
            let (mut hi, mut lo) = (w.clone(), w.clone());
            hi[at] += step;
            lo[at] -= step;
            let numeric = (whole(&hi) - whole(&lo)) / (2.0 * step);
            assert!(
                (numeric - f64::from(d_weights[at])).abs() < 1e-3 * (1.0 + numeric.abs()),
                "{at}: {numeric} {}",
                d_weights[at]
            );
        }
    }

    #[test]
    fn a_network_learns_a_curve() {
        let shape = Network {
            inputs: 1,
            width: 16,
            hidden: 2,
            outputs: 1,
        };
        let mut weights = shape.initial(1, 1.0);
        let inputs: Vec<f32> = (0..200).map(|i| i as f32 / 100.0 - 1.0).collect();
        let error = |out: &[f32]| -> Vec<f32> { out.iter().zip(&inputs).map(|(y, x)| y - (4.0 * x).sin()).collect() };
        let square = |e: &[f32]| e.iter().map(|e| e * e).sum::<f32>() / e.len() as f32;
        let before = square(&error(&shape.forward(&weights, &inputs)));
        let mut speed = vec![0.0f32; weights.len()];
        for _ in 0..800 {
            let d_out = error(&shape.forward(&weights, &inputs));
            let (_, d_weights) = shape.backward(&weights, &inputs, &d_out);
            for ((w, v), d) in weights.iter_mut().zip(&mut speed).zip(d_weights) {
                *v = 0.9 * *v - 3e-5 * d;
                *w += *v;
            }
        }
        let after = square(&error(&shape.forward(&weights, &inputs)));
        assert!(after < 0.1 * before, "{before} {after}");
    }
}
