//! What a shadow method is measured on: a capture or the lobby, with an object in it.

use super::Static;
use crate::config::{Render, Transfer};
use crate::error::{Context as _, Result};
use crate::image::{RadianceImage, luminance};
use crate::shadow::{self, Caster, Occluder, Removed, Scene, Session};
use crate::stage::{peak_memory_mib, reset_peak_memory};
use crate::synthetic::{Lobby, lobby_of};
use crate::transfer::{Transfers, solve};
use glam::Vec3;
use std::time::Instant;

/// Share of the lobby's light that its source set holds; what the fixtures' settings say.
const SHARE: f64 = 0.98;
/// Reference rays per pixel, at first and at most.
const FIRST_RAYS: usize = 64;
const MOST_RAYS: usize = 1 << 12;

/// The lobby with its transfers.
pub(super) struct LobbyTransfers {
    pub lobby: Lobby,
    pub transfers: Transfers,
}

impl LobbyTransfers {
    /// About so many patches, seen in `width` × 3/4 `width` px.
    pub fn new(patches: usize, width: u32) -> Result<Self> {
        Self::seen_in(patches, [width, width * 3 / 4])
    }

    /// The same in a picture of any shape, px.
    pub fn seen_in(patches: usize, size: [u32; 2]) -> Result<Self> {
        let lobby = Lobby::seen_in(lobby_of(patches), size);
        let transfers = solve(&lobby.light, &lobby.receivers, &transfer_settings(), || {})
            .doing("finding the lobby's transfers")?;
        Ok(Self { lobby, transfers })
    }

    pub fn scene(&self) -> Scene<'_> {
        let Lobby { light, receivers, plate, .. } = &self.lobby;
        Scene { light, transfers: &self.transfers, receivers, plate, finish: None, stored: None }
    }
}

/// Settings of the lobby's transfers.
pub(super) fn transfer_settings() -> Transfer {
    Transfer { source_share: SHARE, ..Transfer::default() }
}

/// A scene with an object.
pub(super) struct Subject<'a> {
    pub name: String,
    pub scene: Scene<'a>,
    pub occluder: Occluder,
    pub settings: Render,
}

/// ε of one setting, and the times of its frames.
pub(super) struct Shot {
    pub removed: Removed,
    /// Time of preparing what stays, ms.
    pub prepared_ms: f64,
    /// Each frame, ms.
    pub ms: Vec<f64>,
    /// Memory above that before, MiB.
    pub memory_mib: f64,
}

impl<'a> Subject<'a> {
    /// A capture with the object where the settings put it.
    pub fn capture(name: String, statics: &'a Static, settings: &Render) -> Self {
        let (scene, occluder) = (statics.scene(), statics.occluder());
        Self { name, scene, occluder, settings: settings.clone() }
    }

    /// The lobby with an object in the middle of the view.
    pub fn lobby(made: &'a LobbyTransfers) -> Self {
        let name = format!("lobby {}", made.lobby.light.mesh.patches.len());
        Self {
            name,
            scene: made.scene(),
            occluder: Lobby::object([0.3, 0.6], 0.0),
            settings: Render::default(),
        }
    }

    /// A frame's ε with so many passes (0: one a source), and the times of `frames` more; the first one warms caches.
    pub fn passes(&self, passes: usize, frames: usize) -> Result<Shot> {
        self.shot(&Render { passes, ..self.settings.clone() }, frames)
    }

    /// The same by any method and settings.
    pub fn shot(&self, settings: &Render, frames: usize) -> Result<Shot> {
        let caster = Caster::of(&self.occluder, settings).occluder;
        reset_peak_memory();
        let before = peak_memory_mib();
        let started = Instant::now();
        let mut session = Session::prepare(&self.scene, settings).doing("preparing the shadow method")?;
        let prepared_ms = 1e3 * started.elapsed().as_secs_f64();
        let removed = session.frame(&caster).doing("finding the shadow")?.removed;
        let mut ms = Vec::with_capacity(frames);
        for frame in 0..frames {
            // Moved to and fro by millimetres, so that nothing can be kept from the frame before.
            let by = Vec3::new(1e-3 * (1 + frame % 3) as f32, 0.0, 0.0);
            let mut moved = caster.clone();
            moved.vertices.iter_mut().for_each(|v| *v += by);
            ms.push(1e3 * session.frame(&moved).doing("finding the shadow")?.seconds);
        }
        Ok(Shot { removed, prepared_ms, ms, memory_mib: peak_memory_mib() - before })
    }

    /// ε by rays; other seeds are other samples.
    pub fn traced(&self, rays: usize, seed: u64) -> Result<Removed> {
        let settings = Render { rays, seed, ..self.settings.clone() };
        shadow::raytraced(&self.scene, &self.occluder, &settings).doing("tracing the reference")
    }

    /// ε by so many rays that its noise is below `share` of the least error of some ε, if that can be.
    pub fn reference(&self, share: f64, judged: &[&RadianceImage]) -> Result<Removed> {
        let seed = self.settings.seed ^ 0x5eed;
        let (mut rays, mut found) = (FIRST_RAYS, self.traced(FIRST_RAYS, seed)?);
        // The second guess is the better one: its errors are hardly noise.
        for _ in 0..2 {
            let noise = found.noise.unwrap_or(0.0);
            let with_noise = judged.iter().map(|e| self.errors(e, &found.epsilon).0).fold(f64::MAX, f64::min);
            let error = (with_noise * with_noise - noise * noise).max(0.0).sqrt();
            let wanted = share * error.max(0.1 * with_noise);
            if noise <= wanted || rays >= MOST_RAYS {
                break;
            }
            let more = rays as f64 * (noise / wanted).powi(2) * 1.2;
            rays = (more as usize).clamp(rays + 1, MOST_RAYS);
            found = self.traced(rays, seed)?;
        }
        Ok(found)
    }

    /// Relative shadow error and energy bias of ε where the reference removes more than 2 % of the plate.
    pub fn errors(&self, found: &RadianceImage, reference: &RadianceImage) -> (f64, f64) {
        let (mut difference, mut signal, mut sum, mut sum_reference) = (0.0, 0.0, 0.0, 0.0);
        for ((b, f), r) in self.scene.plate.pixels().iter().zip(found.pixels()).zip(reference.pixels()) {
            if luminance(r.0) <= 0.02 * b.luminance() {
                continue;
            }
            for (f, r) in f.0.iter().zip(r.0).map(|(f, r)| (f64::from(*f), f64::from(r))) {
                difference += (f - r).powi(2);
                signal += r * r;
                sum += f;
                sum_reference += r;
            }
        }
        if signal > 0.0 { ((difference / signal).sqrt(), sum / sum_reference - 1.0) } else { (0.0, 0.0) }
    }
}

/// Slope and intercept of least squares.
pub(super) fn line(points: &[(f64, f64)]) -> (f64, f64) {
    let n = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / n;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let (mut covariance, mut variance) = (0.0, 0.0);
    for p in points {
        covariance += (p.0 - x) * (p.1 - y);
        variance += (p.0 - x).powi(2);
    }
    let slope = if variance > 0.0 { covariance / variance } else { 0.0 };
    (slope, y - slope * x)
}

/// Exponent k of y ∝ xᵏ, by least squares on logarithms.
pub(super) fn exponent(points: &[(f64, f64)]) -> f64 {
    let logs: Vec<_> =
        points.iter().filter(|p| p.0 > 0.0 && p.1 > 0.0).map(|p| (p.0.ln(), p.1.ln())).collect();
    line(&logs).0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_is_found() {
        let points: Vec<_> = (1..6).map(|i| (f64::from(i), 3.0 * f64::from(i).powf(1.5))).collect();
        assert!((exponent(&points) - 1.5).abs() < 1e-12);
        let (slope, start) = line(&[(0.0, 1.0), (1.0, 3.0), (2.0, 5.0)]);
        assert!((slope - 2.0).abs() < 1e-12 && (start - 1.0).abs() < 1e-12);
    }
}
