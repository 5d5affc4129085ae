use super::*;
use crate::config::ExposureOverride;
use crate::error::Problem as _;

fn header(time_s: Option<f64>) -> Header {
    Header {
        width_px: 60,
        height_px: 40,
        bits: 8,
        orientation: 1,
        time_s,
        f_number: Some(8.0),
        iso: Some(100.0),
        ..Header::default()
    }
}

type File<'a> = (Role, &'a str, Header);

fn put(files: &[File], settings: &config::Ingest) -> Result<(Capture, Vec<String>), Problem> {
    let roles = files.iter().map(|(r, f, _)| (*r, f.to_string())).collect();
    let headers = files.iter().map(|(_, f, h)| (f.to_string(), h.clone())).collect();
    assemble(&roles, &headers, settings)
}

fn plate() -> File<'static> {
    (Role::Plate, "p.jpg", header(Some(0.01)))
}

fn stated(file: &str, time_s: Option<f64>) -> config::Ingest {
    let given = ExposureOverride { file: file.into(), time_s, f_number: None, iso: None };
    config::Ingest { exposure: vec![given], ..Default::default() }
}

#[test]
fn no_plate_is_refused() {
    let e = put(&[(Role::Probe, "a.jpg", header(None))], &Default::default()).unwrap_err();
    assert_eq!(e, Problem::NoPlate);
}

#[test]
fn a_missing_time_is_named_with_what_to_write() {
    let files =
        [plate(), (Role::Brackets, "a.jpg", header(Some(0.1))), (Role::Brackets, "b.jpg", header(None))];
    let e = put(&files, &Default::default()).unwrap_err();
    assert_eq!(e.to_string(), "b.jpg (`brackets`) has no exposure time");
    assert!(e.hint().contains("exposure = [{ file = \"b.jpg\", time_s = 0.01 }]"), "{}", e.hint());
    let (capture, _) = put(&files, &stated("b*", Some(0.4))).unwrap();
    assert_eq!(capture.images[2].exposure, Some(Exposure { time_s: 0.4, f_number: 8.0, iso: 100.0 }));
}

#[test]
fn an_override_that_matches_nothing_is_refused() {
    let e = put(&[plate()], &stated("q.jpg", Some(1.0))).unwrap_err();
    assert_eq!(e.hint(), "did you mean `p.jpg`?");
}

#[test]
fn impossible_times_are_refused() {
    for time in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let e = put(&[plate()], &stated("p.jpg", Some(time))).unwrap_err().to_string();
        assert!(e.starts_with("p.jpg has an exposure time (s) of"), "{e}");
    }
}

#[test]
fn sizes_of_exposures_must_agree() {
    let other = Header { width_px: 59, ..header(Some(0.1)) };
    let files = [plate(), (Role::Brackets, "a.jpg", header(Some(0.2))), (Role::Brackets, "b.jpg", other)];
    let e = put(&files, &Default::default()).unwrap_err().to_string();
    assert_eq!(e, "b.jpg is 59×40 px, a.jpg is 60×40 px; they must be of one size for role `brackets`");
}

#[test]
fn orientation_turns_the_size() {
    let turned = Header { orientation: 6, ..header(Some(0.01)) };
    let (capture, _) = put(&[(Role::Plate, "p.jpg", turned)], &Default::default()).unwrap();
    assert_eq!((capture.images[0].width_px, capture.images[0].height_px), (40, 60));
}

#[test]
fn equal_exposures_and_a_varying_aperture_are_warned_of() {
    let wide = Header { f_number: Some(4.0), time_s: Some(0.05), ..header(None) };
    let files = [
        plate(),
        (Role::Brackets, "a.jpg", header(Some(0.2))),
        (Role::Brackets, "b.jpg", header(Some(0.2))),
        (Role::Brackets, "c.jpg", wide),
    ];
    let (_, warnings) = put(&files, &Default::default()).unwrap();
    // f/4 at a quarter of the time is the same exposure, too.
    assert!(
        warnings.iter().any(|w| w.starts_with("a.jpg and b.jpg (brackets) have equal exposures")),
        "{warnings:?}"
    );
    assert!(warnings.iter().any(|w| w.starts_with("a.jpg and c.jpg")), "{warnings:?}");
    assert!(warnings.iter().any(|w| w.starts_with("aperture varies from 4 to 8")), "{warnings:?}");
}

#[test]
fn an_f_number_known_of_some_only_is_refused() {
    let none = Header { f_number: None, ..header(Some(0.2)) };
    let e = put(&[plate(), (Role::Probe, "a.jpg", none)], &Default::default()).unwrap_err();
    assert_eq!(e.to_string(), "p.jpg has an f-number, a.jpg has none, so their exposures cannot be compared");
    assert!(e.hint().contains("exposure = [{ file = \"a.jpg\", f_number = … }]"));
}

#[test]
fn a_plate_and_one_probe_may_go_without_exposures() {
    let files = [(Role::Plate, "p.jpg", header(None)), (Role::Probe, "b.jpg", header(None))];
    let (capture, warnings) = put(&files, &Default::default()).unwrap();
    assert_eq!(capture.plate_exposure().unwrap(), 1.0);
    assert!(warnings[0].contains("taken as exposed alike"), "{warnings:?}");
    let mixed = [plate(), (Role::Probe, "b.jpg", header(None))];
    assert!(matches!(put(&mixed, &Default::default()), Err(Problem::NoExposure { .. })));
}

#[test]
fn a_linear_probe_is_in_units_of_the_plate() {
    let linear = Header { linear: true, f_number: None, iso: None, ..header(None) };
    let (capture, warnings) = put(&[plate(), (Role::Probe, "b.exr", linear)], &Default::default()).unwrap();
    assert_eq!(capture.images[1].exposure, capture.images[0].exposure);
    assert!(warnings[0].starts_with("b.exr states no exposure"), "{warnings:?}");
}

#[test]
fn every_role_named_twice_for_one_file_stands_twice() {
    let files = [
        plate(),
        (Role::Brackets, "p.jpg", header(Some(0.01))),
        (Role::Brackets, "q.jpg", header(Some(0.1))),
    ];
    let (capture, _) = put(&files, &Default::default()).unwrap();
    assert_eq!(capture.images.iter().filter(|p| p.file == "p.jpg").count(), 2);
}

#[test]
fn another_colour_space_is_refused_but_of_the_grid() {
    let adobe = || Header { profile: Some("Adobe RGB".into()), ..header(Some(0.01)) };
    let e = put(&[(Role::Plate, "é 1.jpg", adobe())], &Default::default()).unwrap_err();
    assert_eq!(e.to_string(), "é 1.jpg has Adobe RGB embedded, not sRGB");
    assert!(e.hint().starts_with("develop it again as sRGB"), "{}", e.hint());
    assert!(put(&[plate(), (Role::Grid, "g.jpg", adobe())], &Default::default()).is_ok());
}
