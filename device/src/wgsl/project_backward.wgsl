// Gradients of the core parameters from those of the splats; adds to what the features give to positions.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> parameters: array<f32>;
@group(0) @binding(2) var<storage, read> splats: array<vec4f>;
@group(0) @binding(3) var<storage, read> splat_gradients: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> gradients: array<f32>;
@group(0) @binding(5) var<storage, read_write> report: array<atomic<u32>>;

// To a symmetric matrix (its off-diagonal counts twice) from the gradient to its inverse.
fn inverse_backward(m: vec3f, d: vec3f) -> vec3f {
    let g = vec3f(d.x, 0.5 * d.y, d.z);
    let xx = m.x * (g.x * m.x + g.y * m.y) + m.y * (g.y * m.x + g.z * m.y);
    let xy = m.x * (g.x * m.y + g.y * m.z) + m.y * (g.y * m.y + g.z * m.z);
    let yy = m.y * (g.x * m.y + g.y * m.z) + m.z * (g.y * m.y + g.z * m.z);
    return vec3f(-xx, -2.0 * xy, -yy);
}

fn quaternion_backward(q: vec4f, norm: f32, d: mat3x3f) -> vec4f {
    let xy = d[1].x + d[0].y;
    let xz = d[2].x + d[0].z;
    let yz = d[2].y + d[1].z;
    let r = vec3f(d[1].z - d[2].y, d[2].x - d[0].z, d[0].y - d[1].x);
    let unit = 2.0 * vec4f(
        q.y * xy + q.z * xz - 2.0 * q.x * (d[1].y + d[2].z) + q.w * r.x,
        q.x * xy + q.z * yz - 2.0 * q.y * (d[0].x + d[2].z) + q.w * r.y,
        q.x * xz + q.y * yz - 2.0 * q.z * (d[0].x + d[1].y) + q.w * r.z,
        dot(q.xyz, r),
    );
    if norm <= 0.0 {
        return vec4f(0.0);
    }
    return (unit - dot(unit, q) * q) / norm;
}

fn checked(x: f32, group: u32) -> f32 {
    if !below(x, GRADIENT_MAX) {
        atomicOr(&report[FAULTS], FAULT_GROUP << group);
    }
    return x;
}

fn store_three(at: u32, d: vec3f, group: u32) {
    gradients[at] = checked(d.x, group);
    gradients[at + 1u] = checked(d.y, group);
    gradients[at + 2u] = checked(d.z, group);
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let i = numbered(group, groups, local);
    let n = step.counts.x;
    if i >= n {
        return;
    }
    let of_scale = LOG_SCALE * n + 3u * i;
    let of_rotation = ROTATION * n + 4u * i;
    if splats[3u * i + 2u].z == 0.0 {
        store_three(of_scale, vec3f(0.0), 1u);
        for (var k = 0u; k < 4u; k++) {
            gradients[of_rotation + k] = 0.0;
        }
        gradients[OPACITY * n + i] = 0.0;
        return;
    }
    let g = whitened_of(i, n);
    let to_place = splat_gradients[2u * i];
    let d_opacity = to_place.z;

    // Conic, and the dimming by the filter, to the covariance: dim = sqrt(det_raw / det), with the area for needles.
    let o = g.opacity;
    let dim = g.dimming;
    let d_dim = select(0.0, d_opacity * o, dim > 0.0);
    let k_raw = 0.5 * d_dim * dim / max(dim * dim * g.det, 1e-30);
    let k = 0.5 * d_dim * dim / g.det;
    let area = cross(g.a, g.b) * (2.0 * (k_raw - k));
    let d_cov = inverse_backward(g.conic, splat_gradients[2u * i + 1u].xyz) - vec3f(k * FILTER, 0.0, k * FILTER);

    // Covariance and area to the whitened rows, those to Jacobian, scales and rotation.
    let d_a = g.a * (2.0 * d_cov.x) + g.b * d_cov.y + cross(g.b, area);
    let d_b = g.b * (2.0 * d_cov.z) + g.a * d_cov.y + cross(area, g.a);
    let s_a = g.scale * d_a;
    let s_b = g.scale * d_b;
    let d_ju = g.rotation * s_a;
    let d_jv = g.rotation * s_b;
    store_three(of_scale, g.a * d_a + g.b * d_b, 1u);
    let d_matrix = mat3x3f(g.ju * s_a.x + g.jv * s_b.x, g.ju * s_a.y + g.jv * s_b.y, g.ju * s_a.z + g.jv * s_b.z);
    let d_rotation = quaternion_backward(g.quaternion, g.norm, d_matrix);
    for (var c = 0u; c < 4u; c++) {
        gradients[of_rotation + c] = checked(d_rotation[c], 2u);
    }
    gradients[OPACITY * n + i] = checked(d_opacity * dim * o * (1.0 - o), 3u);

    // The Jacobian rows depend on the position through column, row and denominator.
    let inverse = 1.0 / g.denominator;
    let d_col = to_place.x - dot(step.w.xyz, d_ju) * inverse;
    let d_row = to_place.y - dot(step.w.xyz, d_jv) * inverse;
    let d_w = (dot(g.ju, d_ju) + dot(g.jv, d_jv)) * inverse;
    let before = vec3f(gradients[3u * i], gradients[3u * i + 1u], gradients[3u * i + 2u]);
    store_three(3u * i, before + g.ju * d_col + g.jv * d_row - step.w.xyz * d_w, 0u);
}
