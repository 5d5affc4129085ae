// Depth of the occluder from one source; instance i draws map i of the batch.
#import insitu::shadow_map_types::ShadowMap

@group(0) @binding(0) var<storage, read> maps: array<ShadowMap>;

@vertex
fn draw(@location(0) position: vec3<f32>, @builtin(instance_index) map: u32) -> @builtin(position) vec4<f32> {
    let q = maps[map].map_from_world * vec4<f32>(position, 1.0);
    let half = 0.5 * f32(maps[map].size);
    return vec4<f32>(q.x / half - q.w, q.w - q.y / half, q.z, q.w);
}
