// `truth` is the image to compare with, `[band][pixel]`, then the weights of the pixels.

// The pixel of the image that a rendered value `x` is compared with, and its weight. A saturated pixel contradicts only
// values that are darker; ignored pixels take the rendered value, so that the window sees no edge.
struct Truth {
    // To compare with, and the pixel itself.
    value: f32,
    seen: f32,
    weight: f32,
    known: bool,
}

fn truth_of(x: f32, band: u32, i: u32) -> Truth {
    let pixels = step.size.x * step.size.y;
    var seen = truth[band * pixels + i];
    let known = finite(seen);
    let weight = select(0.0, truth[step.counts.z * pixels + i], known);
    if known && seen >= step.ceiling[band] * (1.0 - 1e-5) && x > seen {
        seen = x;
    }
    return Truth(select(x, seen, weight > 0.0), seen, weight, known);
}
