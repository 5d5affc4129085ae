// Nothing but the texture loads of shadow lookups, neighbouring invocations at neighbouring texels: how fast a device
// could be at best.

struct Work {
    lookups: u32, // of each invocation
    side: u32,    // of a layer of the atlas, texels
    layers: u32,
    width: u32,   // invocations of a row
}

@group(0) @binding(0) var<uniform> work: Work;
@group(0) @binding(1) var<storage, read_write> sums: array<f32>;
@group(0) @binding(2) var atlas: texture_depth_2d_array;

@compute @workgroup_size(16, 16)
fn look(@builtin(global_invocation_id) id: vec3<u32>) {
    let start = vec2<i32>(id.xy % vec2<u32>(work.side - 16u));
    var sum = 0.0;
    for (var i = 0u; i < work.lookups; i++) {
        let texel = start + vec2<i32>(i32(i & 7u), i32((i >> 3u) & 7u));
        let layer = i % work.layers;
        sum += textureLoad(atlas, texel, layer, 0);
    }
    sums[id.y * work.width + id.x] = sum;
}
