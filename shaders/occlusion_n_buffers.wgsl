// The next level of N-buffers: how many texels block of the box from each on to the right and down, whole numbers.
// `NBuffers::new` has means.
#import insitu::occlusion_types::Textures

@group(0) @binding(0) var<uniform> textures: Textures;
@group(0) @binding(1) var<storage, read_write> table: array<u32>;
@group(0) @binding(2) var<uniform> level: vec4<u32>; // the level to make

@compute @workgroup_size(16, 16)
fn widen(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = textures.size;
    let step = 1u << (level.x - 1u);
    let below = id.z * textures.stride + (level.x - 1u) * size * size;
    let here = below + id.y * size + id.x;
    var sum = table[here];
    if id.x + step < size {
        sum += table[here + step];
    }
    if id.y + step < size {
        sum += table[here + step * size];
    }
    if id.x + step < size && id.y + step < size {
        sum += table[here + step * size + step];
    }
    table[here + size * size] = sum;
}
