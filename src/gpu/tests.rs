use super::{Problem, RadianceTransfer};
use crate::config::{Render, Transfer};
use crate::error::Problem as _;
use crate::shadow::{self, Scene};
use crate::synthetic::{Lobby, lobby_of};
use crate::transfer::solve;

#[test]
fn a_lost_device_is_an_error_and_stays_one() {
    let lobby = Lobby::new(lobby_of(250), 48);
    let settings = Transfer { source_share: 0.5, ..Transfer::default() };
    let transfers = solve(&lobby.light, &lobby.receivers, &settings, || {}).unwrap();
    let Lobby { light, receivers, plate, .. } = &lobby;
    let scene = Scene { light, transfers: &transfers, receivers, plate, finish: None, stored: None };
    let mut method = match RadianceTransfer::prepare(&scene, &Render::default()) {
        Ok(method) => method,
        Err(e @ shadow::Problem::Gpu(Problem::NoAdapter(_))) => {
            assert!(std::env::var("INSITU_GPU").as_deref() != Ok("require"), "{e}");
            println!("skipped (1 check): {e}");
            return;
        }
        Err(e) => panic!("{e}"),
    };
    let object = Lobby::object([0.3, 0.6], 0.0);
    assert!(method.timed(&object, 10).unwrap().frame > 0.0);
    method.removed_radiance(&object).unwrap();
    method.lose_device();
    for _ in 0..2 {
        let shadow::Problem::Gpu(problem) = method.removed_radiance(&object).unwrap_err() else { panic!() };
        assert!(matches!(problem, Problem::Lost { .. }), "{problem:?}");
        assert!(problem.hint().contains("render.backend"));
    }
    assert!(method.timed(&object, 10).is_err());
    assert!(method.ceiling().is_err());
    assert!(method.shadow_maps(&object).is_err());
}
