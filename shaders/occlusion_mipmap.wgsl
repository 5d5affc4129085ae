// The next level of a pyramid: how many of the texels below block, whole numbers. `Mipmap::new` has means.
#import insitu::occlusion_types::Textures

@group(0) @binding(0) var<uniform> textures: Textures;
@group(0) @binding(1) var<storage, read_write> table: array<u32>;
@group(0) @binding(2) var<uniform> level: vec4<u32>; // the level to make

@compute @workgroup_size(8, 8)
fn halve(@builtin(global_invocation_id) id: vec3<u32>) {
    let below = textures.size >> (level.x - 1u);
    let side = below >> 1u;
    if id.x >= side || id.y >= side {
        return;
    }
    // Levels lie behind one another: Σ (size / 2^i)².
    let all = textures.size * textures.size;
    let start = id.z * textures.stride;
    let fine = start + 4u * (all - below * below) / 3u + 2u * (id.y * below + id.x);
    let sum = table[fine] + table[fine + 1u] + table[fine + below] + table[fine + below + 1u];
    table[start + 4u * (all - side * side) / 3u + id.y * side + id.x] = sum;
}
