// A receiver pixel of the plate, and ε there.
#define_import_path insitu::receiver

struct Receiver {
    position: vec3<f32>,
    vertex_a: u32,
    normal: vec3<f32>,
    vertex_b: u32,
    weights: vec3<f32>,
    vertex_c: u32,
    across: vec3<f32>,     // one pixel to the right on the surface, m
    place: u32,            // 1 + index into the plate; 0 beyond the last
    down: vec3<f32>,
    padding_b: u32,
    plate: vec3<f32>,      // radiance
    padding_c: u32,
    irradiance: vec3<f32>, // from all light
    padding_d: u32,
}

// The plate's radiance times the blocked share of the irradiance: `Pixel::removed`.
fn removed(receiver: Receiver, blocked: vec3<f32>) -> vec3<f32> {
    let lit = receiver.irradiance > vec3<f32>(0.0);
    let share = clamp(blocked / receiver.irradiance, vec3<f32>(0.0), vec3<f32>(1.0));
    return max(receiver.plate, vec3<f32>(0.0)) * select(vec3<f32>(0.0), share, lit);
}
