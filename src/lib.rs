//! insitu turns a photo set into an augmented photograph: photographs of a room, exposure brackets, a mirror ball and a
//! printed grid go in; a photograph with a synthetic object standing in it comes out, lit by the room's own light and
//! shadowing the room's own surfaces.
//!
//! ```text
//! photos ─► ingest ─► response ─► merge ─┬─► probe ──► model ──┐
//!              │                         │                     ▼
//!              └────► calibrate ─────────┴──────────────► illuminate ─► irradiance ─┐
//!                                                              │                    ▼
//!                                                              └────► transfer ─► render ─► composite ─► evaluate
//! ```
//!
//! One module a stage, in the order of the data: [`exposure`] (ingest), [`response`], [`merge`], [`calibrate`], [`probe`],
//! [`model`], [`illuminate`], [`irradiance`], [`transfer`], [`render`] with [`shadow`], [`subtractive`], [`occlusion`] and
//! [`dome`], [`composite`], [`evaluate`]. [`live`] does the same for a film. What several of them need: [`image`], [`camera`], [`visibility`], [`sh`], [`least_squares`],
//! [`vision`] (OpenCV), [`gpu`].
//! What joins them: [`config`] (`pipeline.toml`), [`annotations`], [`artefact`] (files between stages), [`stage`] (the table
//! of stages and how one runs), [`driver`] (the program `insitu`). Only [`printer`] prints.
//!
//! # Conventions
//!
//! - World: right-handed, metres, **+Y up**; its origin is the centre of the printed grid. Grid frame: x along the long
//!   side, z out of the paper; `world = (x, z, −y)`.
//! - Camera: +X right, +Y down, +Z forward. Transforms are named `a_from_b`.
//! - Pixels: continuous; (0, 0) is the outer corner of the top-left pixel, its centre lies at (0.5, 0.5).
//! - Radiance: linear, scene-referred, Rec. 709, in *plate units*: 1 saturates the plate.
//! - Exposure: t · S / N² with t in s, S = ISO/100, N the f-number.
//! - Environments: OpenEXR `latlong`, see [`probe::latlong`]. Spherical harmonics: see [`sh`].
//! - Angles are radians; settings a person writes end in `_deg`.
//!
//! # Bibliography
//!
//! - **gibson**: Gibson, Cook, Howard, Hubbold: Rapid Shadow Generation in Real-World Lighting Environments, EGSR 2003.
//! - **tutorial**: Gibson, Chalmers: Photorealistic Augmented Reality, Eurographics 2003 tutorial.
//! - **decoro2008**: DeCoro, Rusinkiewicz: Subtractive Shadows: A Flexible Framework for Shadow Level of Detail, JGT 13(1), 2008.
//! - **eisemann2006**: Eisemann, Décoret: Plausible Image Based Soft Shadows Using Occlusion Textures, SIBGRAPI 2006.
//! - **supan2006**: Supan, Stuppacher, Haller: Image Based Shadowing in Real-Time Augmented Reality, IJVR 5(3), 2006.
//! - Garrido-Jurado et al.: Automatic Generation and Detection of Highly Reliable Fiducial Markers, Pattern Recognition 2014.
//! - Benedict and Bordner: Synthesis of an Optimal Set of Radar Track-While-Scan Smoothing Equations, IRE TAC 1962.
//! - Fuhrmann et al.: Occlusion in Collaborative Augmented Environments, Computers and Graphics 1999.
//! - Crow: Summed-Area Tables for Texture Mapping, SIGGRAPH 1984.
//! - Décoret: N-Buffers for Efficient Depth Map Query, Eurographics 2005.
//! - Agarwal, Ramamoorthi, Belongie, Jensen: Structured Importance Sampling of Environment Maps, SIGGRAPH 2003.
//! - Debevec, Malik: Recovering High Dynamic Range Radiance Maps from Photographs, SIGGRAPH 1997.
//! - Debevec: Rendering Synthetic Objects into Real Scenes, SIGGRAPH 1998.
//! - Debevec: A Median Cut Algorithm for Light Probe Sampling, SIGGRAPH 2005 poster.
//! - Ramamoorthi, Hanrahan: An Efficient Representation for Irradiance Environment Maps, SIGGRAPH 2001.
//! - Greger, Shirley, Hubbard, Greenberg: The Irradiance Volume, IEEE CG&A 1998.

pub mod annotations;
pub mod artefact;
pub mod bench;
pub mod calibrate;
pub mod camera;
pub mod cli;
pub mod composite;
pub mod config;
pub mod dome;
pub mod driver;
pub mod error;
pub mod evaluate;
pub mod exposure;
pub mod gpu;
pub mod illuminate;
pub mod image;
pub mod irradiance;
pub mod least_squares;
pub mod live;
pub mod maps;
pub mod merge;
pub mod model;
pub mod occlusion;
pub mod printer;
pub mod probe;
pub mod render;
pub mod response;
pub mod sh;
pub mod shadow;
pub mod stage;
pub mod subtractive;
pub mod synthetic;
pub mod transfer;
pub mod visibility;
pub mod vision;
