// A Gaussian in a view: what the projection and its backward pass both compute.

// Variance of the pixel filter, pixels^2.
const FILTER: f32 = 0.1;

struct Whitened {
    col: f32,
    row: f32,
    denominator: f32,
    // Unit quaternion, and the norm it had; zero where it was degenerate.
    quaternion: vec4f,
    norm: f32,
    rotation: mat3x3f,
    scale: vec3f,
    opacity: f32,
    // Derivatives of column and row to the position.
    ju: vec3f,
    jv: vec3f,
    // The same in the Gaussian's own axes and units.
    a: vec3f,
    b: vec3f,
    // Image covariance without the filter, and its determinant as a squared area.
    covariance: vec3f,
    area_square: f32,
    // Inverse of the filtered covariance, and the determinant of the latter.
    conic: vec3f,
    det: f32,
    // Factor on the opacity.
    dimming: f32,
}

fn matrix(q: vec4f) -> mat3x3f {
    let d = q.xyz + q.xyz;
    let x = q.x * d;
    let yy = q.y * d.y;
    let yz = q.y * d.z;
    let zz = q.z * d.z;
    let w = q.w * d;
    return mat3x3f(
        vec3f(1.0 - (yy + zz), x.y + w.z, x.z - w.y),
        vec3f(x.y - w.z, 1.0 - (x.x + zz), yz + w.x),
        vec3f(x.z + w.y, yz - w.x, 1.0 - (x.x + yy)),
    );
}

fn whitened(position: vec3f, log_scale: vec3f, raw: vec4f, logit: f32) -> Whitened {
    var out: Whitened;
    out.denominator = 1.0 + dot(step.w.xyz, position);
    let inverse = 1.0 / out.denominator;
    out.col = (dot(step.u.xyz, position) + step.u.w) * inverse;
    out.row = (dot(step.v.xyz, position) + step.v.w) * inverse;
    let norm = sqrt(dot(raw, raw));
    let normalisable = norm >= 1e-12 && finite(norm);
    out.norm = select(0.0, norm, normalisable);
    out.quaternion = select(vec4f(0.0, 0.0, 0.0, 1.0), raw / norm, normalisable);
    out.rotation = matrix(out.quaternion);
    out.scale = exp(clamp(log_scale, vec3f(-87.0), vec3f(88.0)));
    out.opacity = 1.0 / (1.0 + exp(-clamp(logit, -87.0, 87.0)));
    out.ju = (step.u.xyz - step.w.xyz * out.col) * inverse;
    out.jv = (step.v.xyz - step.w.xyz * out.row) * inverse;
    out.a = (out.ju * out.rotation) * out.scale;
    out.b = (out.jv * out.rotation) * out.scale;
    let area = cross(out.a, out.b);
    out.covariance = vec3f(dot(out.a, out.a), dot(out.a, out.b), dot(out.b, out.b));
    out.area_square = dot(area, area);
    let m = out.covariance;
    out.det = out.area_square + FILTER * (m.x + m.z + FILTER);
    out.conic = vec3f(m.z + FILTER, -m.y, m.x + FILTER) / out.det;
    out.dimming = sqrt(out.area_square / out.det);
    return out;
}

// Gaussian `i` of `n`; groups lie one after another.
fn whitened_of(i: u32, n: u32) -> Whitened {
    let q = ROTATION * n + 4u * i;
    let raw = vec4f(parameters[q], parameters[q + 1u], parameters[q + 2u], parameters[q + 3u]);
    return whitened(three(3u * i), three(LOG_SCALE * n + 3u * i), raw, parameters[OPACITY * n + i]);
}
