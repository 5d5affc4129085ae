// What the raster pass that draws shadow maps and the compute pass that reads them share.
#define_import_path insitu::shadow_map_types

struct Frame {
    map_px: u32,   // side of a shadow map, texels
    maps: u32,     // maps in this batch
    pixels: u32,   // receiver pixels
    columns: u32,  // receiver vertices: length of a row of transfers
}

struct ShadowMap {
    map_from_world: mat4x4<f32>,  // to (column·w, row·w, depth·w, w)
    planes: mat4x4<f32>,          // its inverse transpose
    radiance: vec3<f32>,          // of the source, times the map's share of the transfer
    row: u32,                     // row of transfers
}
