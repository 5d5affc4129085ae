// What the passes of occlusion textures share: the slices before one light, without the object and with it.
#define_import_path insitu::occlusion_types

struct Textures {
    light_from_world: mat4x4<f32>, // see `RectangularLight::light_from_world`
    radiance: vec3<f32>,           // of the light, plate units
    behind: f32,                   // distance of the centre of projection behind it, m
    near: f32,                     // depth at which the first slice begins, m
    size: u32,                     // side of a texture, texels
    slices: u32,
    prefilter: u32,                // MIPMAP, N_BUFFERS or SUMMED_AREA
    combination: u32,              // PRODUCT, SUM or MAXIMUM
    closed: u32,                   // 1: each slice is projected on the next one too
    first: u32,                    // layers of this batch: 2k slice k of the scene, 2k + 1 of scene and object
    layers: u32,
    stride: u32,                   // words of a layer's table
    last: u32,                     // 1: no batch follows
    padding: vec2<u32>,
    planes: array<vec4<f32>, 16>,  // by slice: depth where it begins and ends, length over which it fades in, m
}

const MIPMAP: u32 = 0u;
const N_BUFFERS: u32 = 1u;
const SUMMED_AREA: u32 = 2u;
const PRODUCT: u32 = 0u;
const SUM: u32 = 1u;
const MAXIMUM: u32 = 2u;

// Half of a texel's bits are of the scene, the other half of the object.
const OBJECT: u32 = 16u;

// 1 where a layer blocks: `Mask::texels` after `Mask::with` and `Mask::closed`.
fn blocks(bits: u32, layer: u32, closed: u32) -> u32 {
    var own = bits & 0xffffu;
    if (layer & 1u) == 1u {
        own |= bits >> OBJECT;
    }
    if closed == 1u {
        own |= own << 1u;
    }
    return (own >> (layer >> 1u)) & 1u;
}
