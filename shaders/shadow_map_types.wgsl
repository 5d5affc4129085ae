// What the raster pass that draws shadow maps and the compute pass that reads them share.
#define_import_path insitu::shadow_map_types

struct Frame {
    maps: u32,     // maps in this batch
    clusters: u32, // of sources: length of a row of transfers
    side: u32,     // of a layer of the atlas, texels
    add: u32,      // 1: to what is blocked already; 0: this is the first batch
}

struct ShadowMap {
    map_from_world: mat4x4<f32>,  // to (column·w, row·w, depth·w, w)
    planes: mat4x4<f32>,          // its inverse transpose
    sides: array<vec4<f32>, 5>,   // planes around what it can shadow; inside gives at least 0, m
    offset: vec2<f32>,            // where in a pixel it is looked up, px from the centre
    weight: f32,                  // its share of its cluster's light
    cluster: u32,                 // column of transfers
    corner: vec2<u32>,            // its first texel in the atlas
    layer: u32,                   // of the atlas
    size: u32,                    // side, texels
}
