//! The project's account of its numbers: the largest error of each formula against f64 over its domain, the error of
//! the naive form, and the cost of the robust one.
//!
//! The binary `stability` writes the account to `docs/numerics.md`; the test `account` holds every formula to its
//! limit.

mod geometry;
mod light;
mod scalar;
mod surface;

use std::time::Instant;

/// The largest error of a form, with its arguments.
#[derive(Debug, Clone, Default)]
pub struct Worst {
    /// The error, as defined in its row.
    pub error: f64,
    /// Arguments of the largest error.
    pub at: String,
    /// Arguments of the first error that was not finite.
    pub broken: Option<String>,
}

impl Worst {
    /// Records an error; `at` describes its arguments.
    pub fn see(&mut self, error: f64, at: impl FnOnce() -> String) {
        if !error.is_finite() {
            self.broken.get_or_insert_with(at);
        } else if self.at.is_empty() || error > self.error {
            (self.error, self.at) = (error, at());
        }
    }

    fn text(&self) -> String {
        match &self.broken {
            Some(at) => format!("**not finite** at {at}"),
            None if self.at.is_empty() => "–".into(),
            None if self.error == 0.0 => "0".into(),
            None => format!("{:.1e} at {}", self.error, self.at),
        }
    }
}

/// Largest errors of one form of a formula.
#[derive(Debug, Clone, Default)]
pub struct Errors {
    /// Largest error of the value.
    pub value: Worst,
    /// Largest error of the gradient; `None` where the formula has no gradient or another row measures it.
    pub gradient: Option<Worst>,
}

/// One formula with its errors, limits and cost.
#[derive(Debug, Clone)]
pub struct Row {
    /// Name of the formula.
    pub formula: &'static str,
    /// The tested domain, and the reference of the error.
    pub domain: &'static str,
    /// Errors of the form in the code.
    pub robust: Errors,
    /// Largest errors of value and gradient allowed.
    pub limit: (f64, f64),
    /// Errors of the naive form.
    pub naive: Errors,
    /// Time of the robust form over that of the naive one, where they were timed.
    pub cost: Option<f64>,
}

impl Row {
    /// Message if the formula exceeds a limit; `None` if it keeps both.
    pub fn fault(&self) -> Option<String> {
        let exceeds = |worst: &Worst, limit: f64| worst.broken.is_some() || worst.error > limit;
        if exceeds(&self.robust.value, self.limit.0) {
            return Some(format!("{}: value {}", self.formula, self.robust.value.text()));
        }
        let gradient = self
            .robust
            .gradient
            .as_ref()
            .filter(|worst| exceeds(worst, self.limit.1));
        gradient.map(|worst| format!("{}: gradient {}", self.formula, worst.text()))
    }

    /// Row of the table, in Markdown.
    pub fn markdown(&self) -> String {
        let gradient = |errors: &Errors| errors.gradient.as_ref().map_or_else(|| "–".to_owned(), Worst::text);
        let cost = self.cost.map_or_else(|| "–".to_owned(), |ratio| format!("{ratio:.2}"));
        format!(
            "| {} | {} | {} | {} | {} | {} | {cost} |",
            self.formula,
            self.domain,
            self.robust.value.text(),
            gradient(&self.robust),
            self.naive.value.text(),
            gradient(&self.naive),
        )
    }
}

/// Measures all formulas; with `timed`, also their costs.
pub fn rows(timed: bool) -> Vec<Row> {
    let mut rows = scalar::rows(timed);
    rows.extend(geometry::rows(timed));
    rows.extend(light::rows(timed));
    rows.extend(surface::rows(timed));
    rows
}

/// Values from `low` to `high` in equal steps, both ends among them.
fn steps(low: f64, high: f64, count: usize) -> impl Iterator<Item = f64> {
    (0..count).map(move |i| low + (high - low) * i as f64 / (count - 1) as f64)
}

/// Time of `a` over that of `b`: the least of several runs each, in alternation.
fn ratio(timed: bool, mut a: impl FnMut(), mut b: impl FnMut()) -> Option<f64> {
    if !timed {
        return None;
    }
    let once = |run: &mut dyn FnMut()| {
        let begun = Instant::now();
        run();
        begun.elapsed().as_secs_f64()
    };
    let (mut least_a, mut least_b) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..9 {
        least_a = least_a.min(once(&mut a));
        least_b = least_b.min(once(&mut b));
    }
    Some(least_a / least_b)
}

/// Applies two functions to the same numbers from `low` to `high`: time of the first over that of the second.
fn ratio_over(timed: bool, low: f32, high: f32, a: impl Fn(f32) -> f32, b: impl Fn(f32) -> f32) -> Option<f64> {
    let inputs: Vec<f32> = steps(low.into(), high.into(), 1 << 18).map(|x| x as f32).collect();
    let (mut first, mut second) = (inputs.clone(), inputs.clone());
    let apply = |f: &dyn Fn(&mut [f32]), out: &mut [f32]| f(std::hint::black_box(out));
    ratio(
        timed,
        || {
            apply(
                &|out| out.iter_mut().zip(&inputs).for_each(|(o, &x)| *o = a(x)),
                &mut first,
            )
        },
        || {
            apply(
                &|out| out.iter_mut().zip(&inputs).for_each(|(o, &x)| *o = b(x)),
                &mut second,
            )
        },
    )
}

/// `|value - exact| / |exact|`, absolute below `floor`.
fn relative(value: f64, exact: f64, floor: f64) -> f64 {
    (value - exact).abs() / exact.abs().max(floor)
}
