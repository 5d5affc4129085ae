use super::*;
use crate::config;
use crate::image::RadianceImage;
use crate::probe::synthetic::render;
use crate::probe::{crop, unwrap};

const PHOTOGRAPHER: f64 = 0.15;

fn sky(d: Vector3<f64>) -> [f32; 3] {
    let window = d.x > 0.6 && d.y.abs() < 0.4;
    let lamp = d.dot(&Vector3::new(-0.3, 0.9, -0.3).normalize()) > 0.99;
    let base = 1.0 + 0.5 * (3.0 * d.z).sin() as f32 + 0.3 * (5.0 * d.x + 2.0 * d.y).cos() as f32;
    let l = if lamp {
        30.0
    } else if window {
        6.0
    } else {
        base
    };
    [l, 0.9 * l, 0.8 * l]
}

/// A crop of the ball from an azimuth, with someone dark behind the camera.
fn shot(azimuth_deg: f64, elevation_deg: f64) -> (ProbeFit, RadianceImage) {
    let settings = config::Probe { position_m: [0.0, 0.0, 3.0], distance_m: 0.8, ..Default::default() };
    let fit = crop::fit((260, 260), [azimuth_deg, elevation_deg], &settings).unwrap();
    let camera = (fit.camera.centre() - fit.centre).normalize();
    let light = |d: Vector3<f64>| if d.angle(&camera) < 0.12 { [0.01; 3] } else { sky(d) };
    // No floor: it lies beyond what a ray reaches.
    let picture = render(&fit.camera, &fit.centre, 0.1, 1.0, light, |_, _| [1.0; 3], 2);
    let picture = Image::from_fn(260, 260, |x, y| {
        let p = nalgebra::Point2::new(x as f64 + 0.5, y as f64 + 0.5);
        match crate::probe::mirror_ball::reflected_ray(&fit.camera, &fit.centre, 0.1, &p) {
            Some(ray) => Radiance(light(ray.direction.into_inner())),
            None => *picture.at(x, y),
        }
    });
    (fit, picture)
}

fn view(fit: ProbeFit, picture: &RadianceImage) -> View {
    let settings = config::Probe { reflectivity: [1.0; 3], width_px: 128, ..Default::default() };
    let clipped = Image::from_fn(260, 260, |_, _| false);
    let seen = unwrap::unwrap(&fit, picture, &clipped, &settings).unwrap();
    View { fit, seen }
}

/// Mean relative error over all directions for which something holds; lamps and windows have borders a texel wide.
fn error(seen: &Unwrapped, holds: impl Fn(Vec3) -> bool) -> f64 {
    let e = &seen.environment;
    let (mut sum, mut area) = (0.0, 0.0);
    for i in (0..e.weight.len()).filter(|i| holds(e.direction(*i))) {
        let d = e.direction(i);
        let truth = sky(Vector3::new(f64::from(d.x), f64::from(d.y), f64::from(d.z)))[1];
        sum += f64::from((e.radiance.pixels()[i].0[1] / truth - 1.0).abs()).min(1.0) * e.solid_angle(i);
        area += e.solid_angle(i);
    }
    sum / area
}

#[test]
fn photographer_and_blind_cone_of_one_view_are_filled_by_the_other() {
    let views: Vec<View> = [0.0, 110.0].map(|a| shot(a, 20.0)).map(|(f, p)| view(f, &p)).into();
    let photographers = |d: Vec3| views.iter().any(|v| d.angle_between(v.towards_camera()) < 0.1);
    let behind = |d: Vec3| views.iter().any(|v| d.angle_between(-v.towards_camera()) < 0.1);
    let alone = combine(&views[..1], PHOTOGRAPHER).unwrap();
    assert_eq!(alone, views[0].seen);
    let hidden = error(&alone, |d| d.angle_between(views[0].towards_camera()) < 0.1);
    assert!(hidden > 0.9, "one view shows its photographer: {hidden}");
    let both = combine(&views, PHOTOGRAPHER).unwrap();
    assert!(both.blind_share < 1e-3, "{}", both.blind_share);
    let errors = [error(&both, |_| true), error(&both, photographers), error(&both, behind)];
    // What one camera hides the other shows farther out, and less sharply.
    assert!(errors[0] < 0.03 && errors[1] < 0.2 && errors[2] < 0.01, "{errors:?}");
    let ratio = ratio(&views[1], &views[0], PHOTOGRAPHER).unwrap();
    assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
}

#[test]
fn a_view_from_elsewhere_is_turned_onto_the_first() {
    let (first, picture) = shot(0.0, 20.0);
    let first = view(first, &picture);
    let (truth, picture) = shot(130.0, 26.0);
    // Said to be from azimuth 40° and elevation 22°.
    let settings = config::Probe { position_m: [0.0, 0.0, 3.0], distance_m: 0.8, ..Default::default() };
    let said = view(crop::fit((260, 260), [40.0, 22.0], &settings).unwrap(), &picture);
    let (turn, agreement) = turn(&said, &first, PHOTOGRAPHER);
    assert!(agreement > 0.9, "{agreement}");
    let found = turned(&said.fit, &turn);
    let off = (found.camera.centre() - truth.camera.centre()).norm() / 0.8;
    assert!(off.to_degrees() < 1.0, "{}", off.to_degrees());
    assert!((found.centre - truth.centre).norm() < 1e-9);
}
