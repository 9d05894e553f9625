// Three parameters from a place on.

fn three(at: u32) -> vec3f {
    return vec3f(parameters[at], parameters[at + 1u], parameters[at + 2u]);
}
