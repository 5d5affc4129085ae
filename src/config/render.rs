//! `[render]`: the object, and how its shadow is found.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// How shadows are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ShadowMethod {
    /// Stratified rays from every pixel: the reference.
    Raytraced,
    /// One shadow map per source (gibson §7).
    RadianceTransfer,
    /// The same, subtracted from the stored codes in 8 bits (gibson §7.1); on the CPU whatever the back end.
    RadianceTransferLdr,
    /// Lights of the environment at the object's place and a coarse shadow buffer (decoro2008).
    Subtractive,
    /// Prefiltered slices before rectangular lights (eisemann2006).
    OcclusionTextures,
    /// A light for each texel of a coarse cube map of the environment at the object's place (supan2006); on the CPU
    /// whatever the back end.
    LightDome,
}

/// How the method `occlusion-textures` prefilters its textures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OcclusionFilter {
    /// Pyramid, trilinear lookups.
    Mipmap,
    /// Means over boxes of powers of two at every place.
    NBuffers,
    /// Exact means over any box.
    SummedArea,
}

impl OcclusionFilter {
    /// From the coarsest to the exact one.
    pub const ALL: [Self; 3] = [Self::Mipmap, Self::NBuffers, Self::SummedArea];
}

/// How the method `occlusion-textures` combines what its slices block.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Combination {
    /// As independent.
    Product,
    /// As disjoint.
    Sum,
    /// As nested.
    Maximum,
}

impl Combination {
    /// The paper's, then those it is compared with.
    pub const ALL: [Self; 3] = [Self::Product, Self::Sum, Self::Maximum];
}

/// A rectangular light, in the grid's frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AreaLight {
    /// A corner, m.
    pub corner_m: [f64; 3],
    /// From the corner along one side to the next corner, m.
    pub side_u_m: [f64; 3],
    /// Along the other side. Where no surface of the model lies on the rectangle, it shines along u × v.
    pub side_v_m: [f64; 3],
    /// Plate units; without it, that of the surface that it lies on.
    #[serde(default)]
    pub radiance: Option<[f32; 3]>,
}

/// How the method `subtractive` finds the lights that stand for an environment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LightSampling {
    /// By power and extent, bright regions first (Agarwal et al. 2003).
    Structured,
    /// Into cells of equal power (Debevec 2005).
    MedianCut,
}

/// By what the method `subtractive` reflects the object's gloss.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Gloss {
    /// GGX where the object's file has a roughness (glTF), else Phong.
    ByFile,
    /// Phong's lobe (Lafortune and Willems 1994), prefiltered.
    Phong,
    /// Torrance and Sparrow 1967, by a radiance cache.
    TorranceSparrow,
    /// Walter et al. 2007, by a radiance cache.
    Ggx,
}

/// Where shadow maps are made and subtracted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Backend {
    /// rayon.
    Cpu,
    /// wgpu.
    Gpu,
}

settings! {
    /// A placement on a path.
    Pose {
        /// As `render.position_m`.
        position_m: [f64; 3] = [0.0; 3],
        /// As `render.rotation_deg`.
        rotation_deg: f64 = 0.0,
    }
}

settings! {
    /// The synthetic object and its shadow.
    Render {
        /// The object, glTF, OBJ or PLY, in metres, relative to this file.
        object: PathBuf = "object.obj".into(),
        /// Where the object's origin stands, in the grid's frame, m (x along its long side, z out of it).
        position_m: [f64; 3] = [0.0; 3],
        /// Turn about the grid's z axis.
        rotation_deg: f64 = 0.0,
        /// Further placements, each rendered as a frame of its own.
        path: Vec<Pose> = Vec::new(),
        /// Size of the object against its file.
        scale: f64 = 1.0,
        /// +Y of the object's file is up (glTF's habit); otherwise +Z is.
        y_up: bool = false,
        /// Diffuse reflectance, for files without materials.
        diffuse: [f32; 3] = [0.5; 3],
        /// Phong specular reflectance, for files without materials.
        specular: [f32; 3] = [0.0; 3],
        /// Phong exponent.
        shininess: f32 = 50.0,
        /// By what the method `subtractive` reflects gloss; all others take Phong's.
        gloss: Gloss = Gloss::ByFile,
        /// α of GGX, root mean square slope of Torrance and Sparrow's facets, where the file has none.
        roughness: f32 = 0.2,
        /// Smooth normals across edges below this angle, where the file has none.
        smooth_deg: f64 = 60.0,
        /// Rays per pixel of the object by which it shadows and lights itself.
        shading_rays: usize = 128,
        /// Rays per pixel by which the scene gets the light that the object reflects; 0 leaves that out.
        reflected_rays: usize = 64,
        /// Width of the environment map at the object, px; its height is half of that.
        environment_px: usize = 128,
        /// Rays per pixel along each side, for edges.
        antialiasing: usize = 4,
        /// How shadows are found.
        method: ShadowMethod = ShadowMethod::RadianceTransfer,
        /// Where shadow maps are made.
        backend: Backend = Backend::Cpu,
        /// Side of a shadow map, texels.
        shadow_map_px: usize = 256,
        /// Clusters into which the sources are gathered, each with a shadow of its own (gibson §8); 0 for one a source.
        passes: usize = 50,
        /// Hard shadows (small shadow maps) of which each cluster's soft one is made, on average; 1 for the paper's one.
        origins: usize = 8,
        /// How far the scene's own shadows may lie beside the model's, px: those of the methods `radiance-transfer`,
        /// `radiance-transfer-ldr` and `raytraced` are moved to where the plate shows them; 0 leaves them.
        register_px: usize = 4,
        /// Time for a frame, ms: no more passes than earlier frames say can be done in it; 0 for any. `subtractive` spends half
        /// of it on the plate's lights and samples, half on the object.
        frame_ms: f64 = 0.0,
        /// Relative shadow error: no more passes than it needs by estimate; 0 for as many as `passes` says.
        max_error: f64 = 0.0,
        /// Triangles to which the object is simplified in shadow maps; 0 for as it is.
        caster_triangles: usize = 500,
        /// Share of the sources that `radiance-transfer-ldr` deals into the first of its two sets.
        first_set_share: f64 = 0.5,
        /// Shadow rays per pixel of the method `raytraced`.
        rays: usize = 1024,
        /// Lights of the method `subtractive` (illumination detail).
        lights: usize = 200,
        /// How they are found.
        light_sampling: LightSampling = LightSampling::Structured,
        /// Pixels that share a sample of its shadow buffer: 1, 4, 16, 64, 256 or 1024 (sampling detail).
        pixels_per_sample: usize = 4,
        /// The object of the method `subtractive` is lit light by light instead, to compare.
        additive: bool = false,
        /// Rectangular lights of the method `occlusion-textures`; where none is given, those found in the light model.
        area_lights: Vec<AreaLight> = Vec::new(),
        /// Slices into which it cuts the space before each, 1 to 16.
        slices: usize = 16,
        /// Side of its occlusion textures, texels; a power of two.
        occlusion_px: usize = 512,
        /// How these are prefiltered.
        occlusion_filter: OcclusionFilter = OcclusionFilter::SummedArea,
        /// How slices are combined.
        combination: Combination = Combination::Product,
        /// Slices are projected on the next one too: thin surfaces leak less, penumbrae of others grow too dark.
        close_leaks: bool = false,
        /// Lights of the method `light-dome` along an edge of each face of the cube: 4 or 8 in the paper; a power of two.
        dome_texels: usize = 8,
        /// They stand at the centroid of their texel's brightness instead of in its middle.
        dome_centroid: bool = true,
        /// So many texels, those whose light stands worst first, are split into four.
        dome_splits: usize = 16,
        /// The lights stand at infinity, as in the paper, and not where the scene model is seen.
        dome_at_infinity: bool = false,
        /// Seed of all random choices.
        seed: u64 = 1,
    }
}
