// Share of a square that a layer blocks, from its prefiltered table: `Mipmap::average`, `NBuffers::average` and
// `SummedArea::average` in src/occlusion.
#define_import_path insitu::occlusion_lookup
#import insitu::occlusion_types::{Textures, MIPMAP, N_BUFFERS}

@group(0) @binding(0) var<uniform> textures: Textures;
@group(0) @binding(1) var<storage, read> table: array<u32>;

// Of a layer whose table begins at `start`.
fn average(start: u32, centre: vec2<f32>, side: f32) -> f32 {
    if textures.prefilter == MIPMAP {
        return mipmap(start, centre, side);
    }
    if textures.prefilter == N_BUFFERS {
        return n_buffers(start, centre, side);
    }
    return summed_area(start, centre, side);
}

fn bilinear(at: vec4<u32>, part: vec2<f32>) -> f32 {
    let upper = f32(table[at.x]) * (1.0 - part.x) + f32(table[at.y]) * part.x;
    let lower = f32(table[at.z]) * (1.0 - part.x) + f32(table[at.w]) * part.x;
    return upper * (1.0 - part.y) + lower * part.y;
}

fn mipmap_level(start: u32, level: u32, centre: vec2<f32>) -> f32 {
    let side = textures.size >> level;
    let first = start + 4u * (textures.size * textures.size - side * side) / 3u;
    let texel = f32(1u << level);
    let at = clamp(centre / texel - 0.5, vec2<f32>(0.0), vec2<f32>(f32(side - 1u)));
    let low = vec2<u32>(at);
    let high = min(low + 1u, vec2<u32>(side - 1u));
    let rows = first + vec2<u32>(low.y, high.y) * side;
    let corners = vec4<u32>(rows.x + low.x, rows.x + high.x, rows.y + low.x, rows.y + high.x);
    return bilinear(corners, at - vec2<f32>(low)) / (texel * texel);
}

fn mipmap(start: u32, centre: vec2<f32>, side: f32) -> f32 {
    let top = firstTrailingBit(textures.size);
    let lod = min(log2(max(side, 1.0)), f32(top));
    let level = u32(lod);
    let fine = mipmap_level(start, level, centre);
    if level == top {
        return fine;
    }
    return fine + (mipmap_level(start, level + 1u, centre) - fine) * (lod - f32(level));
}

fn n_buffers_level(start: u32, level: u32, centre: vec2<f32>) -> f32 {
    let size = textures.size;
    let first = start + level * size * size;
    let side = 1u << level;
    let last = size - side;
    let at = clamp(centre - 0.5 * f32(side), vec2<f32>(0.0), vec2<f32>(f32(last)));
    let low = vec2<u32>(at);
    let high = min(low + 1u, vec2<u32>(last));
    let rows = first + vec2<u32>(low.y, high.y) * size;
    let corners = vec4<u32>(rows.x + low.x, rows.x + high.x, rows.y + low.x, rows.y + high.x);
    return bilinear(corners, at - vec2<f32>(low)) / (f32(side) * f32(side));
}

fn n_buffers(start: u32, centre: vec2<f32>, wanted: f32) -> f32 {
    let top = firstTrailingBit(textures.size);
    let side = clamp(wanted, 1.0, f32(textures.size));
    // The whole part of the logarithm is the exponent: no rounding at powers of two.
    let level = min(firstLeadingBit(u32(side)), top);
    let fine = n_buffers_level(start, level, centre);
    if level == top {
        return fine;
    }
    let coarse = n_buffers_level(start, level + 1u, centre);
    return fine + (coarse - fine) * (side / f32(1u << level) - 1.0);
}

// Blocking texels in the columns a..b and rows c..d: a difference of whole numbers, exact however large the sums.
fn texels(start: u32, a: u32, b: u32, c: u32, d: u32) -> f32 {
    let upper = start + c * (textures.size + 1u);
    let lower = start + d * (textures.size + 1u);
    return f32(table[lower + b] - table[lower + a] - table[upper + b] + table[upper + a]);
}

// The square's whole columns and the parts of its first and last ones, by as many rows likewise.
fn summed_area(start: u32, centre: vec2<f32>, side: f32) -> f32 {
    let limit = vec2<f32>(f32(textures.size));
    let low = clamp(centre - 0.5 * side, vec2<f32>(0.0), limit);
    let high = clamp(centre + 0.5 * side, vec2<f32>(0.0), limit);
    let from_texel = min(vec2<u32>(low), vec2<u32>(textures.size - 1u));
    let to_texel = min(vec2<u32>(high), vec2<u32>(textures.size - 1u));
    let less = low - vec2<f32>(from_texel);
    let more = high - vec2<f32>(to_texel);
    // From, to and weight of each.
    var columns = array<vec3<f32>, 3>(
        vec3<f32>(f32(from_texel.x), f32(to_texel.x), 1.0),
        vec3<f32>(f32(to_texel.x), f32(to_texel.x + 1u), more.x),
        vec3<f32>(f32(from_texel.x), f32(from_texel.x + 1u), -less.x),
    );
    var rows = array<vec3<f32>, 3>(
        vec3<f32>(f32(from_texel.y), f32(to_texel.y), 1.0),
        vec3<f32>(f32(to_texel.y), f32(to_texel.y + 1u), more.y),
        vec3<f32>(f32(from_texel.y), f32(from_texel.y + 1u), -less.y),
    );
    var area = 0.0;
    for (var i = 0; i < 3; i++) {
        for (var j = 0; j < 3; j++) {
            let weight = columns[i].z * rows[j].z;
            if weight != 0.0 {
                area += weight * texels(start, u32(columns[i].x), u32(columns[i].y), u32(rows[j].x), u32(rows[j].y));
            }
        }
    }
    return clamp(area / (side * side), 0.0, 1.0);
}
