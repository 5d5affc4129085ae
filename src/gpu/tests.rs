use super::{Device, Problem, RadianceTransfer, Twin};
use crate::config::{Render, Transfer};
use crate::error::Problem as _;
use crate::occlusion::{Frustum, Mask, RectangularLight, Slices};
use crate::shadow::{self, Scene};
use crate::synthetic::{Lobby, lobby_of};
use crate::transfer::solve;
use glam::Vec3;

/// `None`, said aloud, where there is no adapter.
pub(super) fn device() -> Option<Device> {
    match Device::open(u64::MAX) {
        Ok(device) => Some(device),
        Err(e) => {
            assert!(std::env::var("INSITU_GPU").as_deref() != Ok("require"), "{e}");
            println!("skipped (1 check): {e}");
            None
        }
    }
}

#[test]
fn slices_are_drawn_as_on_the_cpu() {
    let Some(device) = device() else { return };
    let room = Lobby::new(1.5, 48);
    let light = RectangularLight {
        centre: Vec3::new(0.45, 3.0, 0.45),
        half: [Vec3::X * 0.25, Vec3::Z * 0.25],
        radiance: [1.0; 3],
    };
    let object = Lobby::object([0.3, 0.6], 0.4);
    let (size, slices) = (128, Slices::around([1.0, 2.6], 3.0, 12));
    let floor = [Vec3::new(-1.0, 0.0, -1.0), Vec3::new(2.0, 0.0, 1.5)];
    let frustum = Frustum::fit(&light, floor.into_iter());
    let triangles = room.light.mesh.triangles();
    let found = super::occlusion::draw_alone(
        &device,
        [(&room.light.mesh.vertices, &triangles), (&object.vertices, &object.triangles)],
        (&frustum, &slices, size),
    )
    .unwrap();
    let plain = [(&room.light.mesh.vertices, &triangles), (&object.vertices, &object.triangles)]
        .map(|(vertices, triangles)| Mask::draw(&frustum, &slices, size, vertices, triangles));
    for (mask, shift) in plain.iter().zip([0, 16]) {
        let marked = mask.bits.iter().filter(|b| **b != 0).count();
        let other = mask.bits.iter().zip(&found).filter(|(a, b)| u32::from(**a) != **b >> shift & 0xffff);
        // Rounding may move an outline or a slice's border by a texel, in few places.
        let other = other.count();
        assert!(marked > 200 && other * 200 <= marked, "{other} of {marked} texels");
    }
}

/// Why lights come in batches.
#[test]
fn llvmpipe_ends_a_loop_after_65535_rounds() {
    let Some(device) = device() else { return };
    let source = "
        @group(0) @binding(0) var<storage, read_write> rounds: array<u32>;
        @compute @workgroup_size(1) fn count() {
            let end = rounds[1];
            for (var i = 0u; i < end; i++) { rounds[0] = i + 1u; }
        }";
    let source = wgpu::ShaderSource::Wgsl(source.into());
    let module = device.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source });
    let pipeline = device.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: None,
        layout: None,
        module: &module,
        entry_point: Some("count"),
        compilation_options: Default::default(),
        cache: None,
    });
    let rounds = device.storage("rounds", 256);
    device.queue.write_buffer(&rounds, 0, bytemuck::cast_slice(&[0u32, 100_000]));
    let bound = device.bind(&pipeline.get_bind_group_layout(0), [rounds.as_entire_binding()]);
    let staging = device.staging(256);
    let mut encoder = device.device.create_command_encoder(&Default::default());
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &bound, &[]);
        pass.dispatch_workgroups(1, 1, 1);
    }
    encoder.copy_buffer_to_buffer(&rounds, 0, &staging, 0, 256);
    device.queue.submit([encoder.finish()]);
    let found = device.read::<u32>(&staging).unwrap()[0];
    let software = device.adapter.contains("llvmpipe");
    println!("{}: {found} rounds of 100000", device.adapter);
    assert!(
        if software { found.abs_diff(65_535) <= 1 } else { found == 100_000 },
        "{}: {found}",
        device.adapter
    );
}

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
    assert!(method.timed(&object).unwrap().frame > 0.0);
    method.removed_radiance(&object).unwrap();
    method.lose_device();
    for _ in 0..2 {
        let shadow::Problem::Gpu(problem) = method.removed_radiance(&object).unwrap_err() else { panic!() };
        assert!(matches!(problem, Problem::Lost { .. }), "{problem:?}");
        assert!(problem.hint().contains("render.backend"));
    }
    assert!(method.timed(&object).is_err());
    assert!(method.ceiling().is_err());
    assert!(method.shadow_maps(&object).is_err());
}
