// What the raster pass that draws shadow maps and the compute pass that reads them share.
#define_import_path insitu::shadow_map_types

struct Frame {
    maps: u32,     // maps in this batch
    pixels: u32,   // receiver pixels
    clusters: u32, // of sources: length of a row of transfers
    padding: u32,
}

struct ShadowMap {
    map_from_world: mat4x4<f32>,  // to (column·w, row·w, depth·w, w)
    planes: mat4x4<f32>,          // its inverse transpose
    sides: array<vec4<f32>, 5>,   // planes around what it can shadow; inside gives at least 0, m
    offset: vec2<f32>,            // where in a pixel it is looked up, px from the centre
    weight: f32,                  // its share of its cluster's light
    cluster: u32,                 // column of transfers
    size: u32,                    // side, texels, at most that of its layer
    padding: array<u32, 3>,
}
