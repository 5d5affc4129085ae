//! What shows the environment without a camera of its own in the scene: a fisheye lens in the ball's place, or a ready map.

use super::{Environment, ProbeFit, Problem, Unwrapped, crop, fisheye, latlong};
use crate::calibrate::world_from_grid;
use crate::camera::Camera;
use crate::config::{self, ProbeSource};
use crate::dome::Fisheye;
use crate::image::RadianceImage;
use crate::maps::{self, Layout};
use crate::merge::Merged;
use glam::{Mat3, Vec3};
use nalgebra::Point3;

/// Where lens or map stood, and how finely an environment of so many texels shows it.
fn placed(source: ProbeSource, plate: &Camera, settings: &config::Probe) -> (ProbeFit, Vec3) {
    let centre = world_from_grid() * Point3::from(settings.position_m);
    // The blur is 2 / d, a texel's 2π / (w √12).
    let diameter_px = settings.width_px as f64 * 12f64.sqrt() / std::f64::consts::PI;
    let fit = ProbeFit::stated(source, plate.clone(), centre, settings.radius_m, diameter_px);
    (fit, Vec3::new(centre.x as f32, centre.y as f32, centre.z as f32))
}

/// The environment of a fisheye's picture; what its field leaves out stays blind.
pub fn of_fisheye(
    merged: &Merged,
    plate: &Camera,
    settings: &config::Probe,
) -> Result<(ProbeFit, Unwrapped), Problem> {
    if settings.focal_px <= 0.0 {
        return Err(Problem::Focal(settings.focal_px));
    }
    let (fit, place) = placed(ProbeSource::Fisheye, plate, settings);
    let (w, h) = merged.radiance.size();
    let (forward, up) = crop::looking(settings.azimuth_deg, settings.elevation_deg);
    let rotation = crop::rotation(&forward, &up);
    let axis = |k: usize| {
        let c = rotation.matrix().column(k);
        Vec3::new(c[0] as f32, c[1] as f32, c[2] as f32)
    };
    let lens = Fisheye {
        projection: settings.projection,
        focal_px: settings.focal_px,
        centre_px: settings.principal_point_px.unwrap_or([w as f64 / 2.0, h as f64 / 2.0]),
        half_field: settings.field_deg.to_radians() / 2.0,
        world_from_camera: Mat3::from_cols(axis(0), axis(1), axis(2)),
    };
    let seen = fisheye::unwrap(&lens, place, &merged.radiance, &merged.clipped, settings.width_px);
    Ok((fit, seen))
}

/// A ready map as an environment, by solid angle; its middle shows `azimuth_deg`.
pub fn of_map(
    map: &RadianceImage,
    plate: &Camera,
    settings: &config::Probe,
) -> Result<(ProbeFit, Unwrapped), Problem> {
    let size = map.size();
    if !settings.layout.fits(size) {
        return Err(Problem::Shape { size: [size.0, size.1], aspect: settings.layout.aspect() });
    }
    let (fit, place) = placed(ProbeSource::Map, plate, settings);
    let height = settings.width_px / 2;
    let map = maps::convert(map, settings.layout, Layout::Latlong, height);
    let (forward, _) = crop::looking(settings.azimuth_deg, 0.0);
    let longitude = forward.x.atan2(forward.z);
    let radiance = latlong::turned(&map, longitude / std::f64::consts::TAU * (2 * height) as f64);
    let texels = 2 * height * height;
    let environment = Environment { radiance, origin: vec![place; texels], weight: vec![1.0; texels] };
    Ok((fit, Unwrapped { environment, clipped_power_share: 0.0, blind_share: 0.0 }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::image::{Image, Radiance};
    use crate::probe::fisheye::Projection;

    fn plate() -> Camera {
        Camera { intrinsics: Intrinsics::pinhole(64, 48, 60.0), world_from_camera: Default::default() }
    }

    fn brightest(environment: &Environment) -> Vec3 {
        let pixels = environment.radiance.pixels();
        let at = (0..pixels.len()).max_by(|a, b| pixels[*a].0[0].total_cmp(&pixels[*b].0[0])).unwrap();
        environment.direction(at)
    }

    #[test]
    fn the_middle_of_a_map_shows_its_azimuth_in_every_layout() {
        for layout in [Layout::Latlong, Layout::Cube, Layout::Sphere, Layout::Octahedral] {
            let size = layout.size(64);
            let lamp = |d: Vec3| [if d.angle_between(Vec3::Z) < 0.15 { 50.0 } else { 0.5 }; 3];
            let map = Image::from_fn(size.0, size.1, |x, y| {
                Radiance(lamp(layout.direction(x as f32 + 0.5, y as f32 + 0.5, size)))
            });
            // The grid's +y is our −z, its +x our +x.
            for (azimuth_deg, towards) in [(0.0, Vec3::X), (90.0, Vec3::NEG_Z), (-90.0, Vec3::Z)] {
                let settings = config::Probe { layout, azimuth_deg, width_px: 128, ..Default::default() };
                let (fit, seen) = of_map(&map, &plate(), &settings).unwrap();
                let off = brightest(&seen.environment).angle_between(towards);
                assert!(off < 0.2, "{layout:?} {azimuth_deg}: {off}");
                assert_eq!(fit.source, ProbeSource::Map);
                let power = maps::power(&map, layout)[0];
                let kept = maps::power(&seen.environment.radiance, Layout::Latlong)[0];
                assert!((kept / power - 1.0).abs() < 5e-3, "{layout:?}: {kept} {power}");
            }
        }
        let bad = config::Probe { layout: Layout::Cube, ..Default::default() };
        let square = Image::from_fn(8, 8, |_, _| Radiance([1.0; 3]));
        let e = of_map(&square, &plate(), &bad).unwrap_err();
        assert_eq!(e, Problem::Shape { size: [8, 8], aspect: 6 });
    }

    #[test]
    fn a_fisheye_that_looks_up_shows_what_is_above_and_nothing_below() {
        let settings = config::Probe {
            projection: Projection::Equisolid,
            focal_px: 70.0,
            elevation_deg: 90.0,
            width_px: 128,
            ..Default::default()
        };
        // A lamp to the right of the middle: with azimuth 0 the picture's down is the grid's +x, its right …
        let picture = Image::from_fn(200, 200, |x, y| {
            Radiance([if x > 155 && x < 165 && y > 95 && y < 105 { 40.0 } else { 1.0 }; 3])
        });
        let clipped = Image::from_fn(200, 200, |_, _| false);
        let merged = Merged { clipped, ..Merged::from_linear(&picture) };
        let (_, seen) = of_fisheye(&merged, &plate(), &settings).unwrap();
        assert!((seen.blind_share - 0.5).abs() < 0.02, "{}", seen.blind_share);
        let lamp = brightest(&seen.environment);
        // … the grid's −y … and that is our +z: forward × up = z × −x = −y.
        let angle = 2.0 * (60.0f32 / 70.0 / 2.0).asin();
        let truth = Vec3::new(0.0, angle.cos(), angle.sin());
        assert!(lamp.angle_between(truth) < 0.06, "{lamp} {truth}");
        assert_eq!(of_fisheye(&merged, &plate(), &Default::default()).unwrap_err(), Problem::Focal(0.0));
    }
}
