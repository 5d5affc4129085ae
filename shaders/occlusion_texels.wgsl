// The finest level of mipmaps and N-buffers: 1 where a layer blocks.
#import insitu::occlusion_types::{Textures, blocks}

@group(0) @binding(0) var<uniform> textures: Textures;
@group(0) @binding(1) var<storage, read_write> table: array<u32>;
@group(0) @binding(2) var<storage, read> mask: array<u32>;

@compute @workgroup_size(16, 16)
fn fill(@builtin(global_invocation_id) id: vec3<u32>) {
    let texel = id.y * textures.size + id.x;
    table[id.z * textures.stride + texel] = blocks(mask[texel], textures.first + id.z, textures.closed);
}
