// Real spherical harmonics to degree 3 and their gradients, as in the engine's shade::sh, and the direction of view.

const FUNCTIONS: u32 = 16u;
const S0: f32 = 0.2820948;
const S1: f32 = 0.48860252;
const S2 = vec3f(1.0925484, 0.31539157, 0.5462742);
const S3 = vec4f(0.5900436, 2.8906114, 0.4570458, 0.37317634);
const S35: f32 = 1.4453057;

// Unit direction from the camera to a point, and one over the distance; zero where rays are parallel.
fn view_direction(position: vec3f) -> vec4f {
    let offset = select(step.axis.xyz, position - step.eye.xyz, step.eye.w > 0.0);
    let inverse = 1.0 / max(length(offset), 1e-12);
    return vec4f(offset * inverse, select(0.0, inverse, step.eye.w > 0.0));
}

fn basis(d: vec3f) -> array<f32, FUNCTIONS> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    return array<f32, FUNCTIONS>(
        S0,
        -S1 * y,
        S1 * z,
        -S1 * x,
        S2.x * x * y,
        -S2.x * y * z,
        S2.y * (2.0 * zz - xx - yy),
        -S2.x * x * z,
        S2.z * (xx - yy),
        -S3.x * y * (3.0 * xx - yy),
        S3.y * x * y * z,
        -S3.z * y * (4.0 * zz - xx - yy),
        S3.w * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -S3.z * x * (4.0 * zz - xx - yy),
        S35 * z * (xx - yy),
        -S3.x * x * (xx - 3.0 * yy),
    );
}

fn basis_gradients(d: vec3f) -> array<vec3f, FUNCTIONS> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    return array<vec3f, FUNCTIONS>(
        vec3f(0.0),
        vec3f(0.0, -S1, 0.0),
        vec3f(0.0, 0.0, S1),
        vec3f(-S1, 0.0, 0.0),
        vec3f(y, x, 0.0) * S2.x,
        vec3f(0.0, z, y) * -S2.x,
        vec3f(-2.0 * x, -2.0 * y, 4.0 * z) * S2.y,
        vec3f(z, 0.0, x) * -S2.x,
        vec3f(2.0 * x, -2.0 * y, 0.0) * S2.z,
        vec3f(6.0 * x * y, 3.0 * xx - 3.0 * yy, 0.0) * -S3.x,
        vec3f(y * z, x * z, x * y) * S3.y,
        vec3f(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z) * -S3.z,
        vec3f(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy) * S3.w,
        vec3f(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z) * -S3.z,
        vec3f(2.0 * x * z, -2.0 * y * z, xx - yy) * S35,
        vec3f(3.0 * xx - 3.0 * yy, -6.0 * x * y, 0.0) * -S3.x,
    );
}

// Place of the red coefficient of function `f` of Gaussian `i` of `n`: a group for each degree.
fn coefficient(f: u32, degree: u32, i: u32, n: u32) -> u32 {
    let before = degree * degree;
    return (FEATURES + 3u * before) * n + (i * (2u * degree + 1u) + f - before) * 3u;
}

// Degree of function `f`.
fn degree_of(f: u32) -> u32 {
    return select(select(select(0u, 1u, f >= 1u), 2u, f >= 4u), 3u, f >= 9u);
}
