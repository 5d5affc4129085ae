// Summed-area tables in whole numbers: along all rows, then along all columns. One texel wider and higher than the
// texture, as `SummedArea` in src/occlusion.
#import insitu::occlusion_types::{Textures, blocks}

@group(0) @binding(0) var<uniform> textures: Textures;
@group(0) @binding(1) var<storage, read_write> table: array<u32>;
@group(0) @binding(2) var<storage, read> mask: array<u32>;

@compute @workgroup_size(64)
fn along_rows(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = textures.size;
    let width = size + 1u;
    let y = id.x;
    if y > size {
        return;
    }
    let row = id.y * textures.stride + y * width;
    var sum = 0u;
    table[row] = 0u;
    for (var x = 0u; x < size; x++) {
        if y > 0u {
            sum += blocks(mask[(y - 1u) * size + x], textures.first + id.y, textures.closed);
        }
        table[row + x + 1u] = sum;
    }
}

@compute @workgroup_size(64)
fn along_columns(@builtin(global_invocation_id) id: vec3<u32>) {
    let width = textures.size + 1u;
    if id.x >= width {
        return;
    }
    var at = id.y * textures.stride + id.x;
    var sum = 0u;
    for (var y = 0u; y < width; y++) {
        sum += table[at];
        table[at] = sum;
        at += width;
    }
}
