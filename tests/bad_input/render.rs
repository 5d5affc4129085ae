//! The object: stage `render`.

use super::cases::{case, check};
use super::spoil::Spoil::{self, *};

#[test]
fn objects_are_checked() {
    check(&[
        case(
            "object missing",
            &[Set(r#"[render]
object = "chair.glb"
"#)],
            "render",
            1,
            "opening an input of stage `render`: ./chair.glb: No such file or directory (os error 2)",
            "check the name and the folder in pipeline.toml",
        ),
        case(
            "object empty",
            &[
                Write("o.obj", ""),
                Set(r#"[render]
object = "o.obj"
"#),
            ],
            "render",
            1,
            "reading the object ./o.obj: the mesh is empty: 0 vertices, 0 triangles, 0 of them without area",
            "export the object as triangles or polygons, with at least one of them",
        ),
        case(
            "only points",
            &[
                Write("o.obj", "v 0 0 0\nv 1 0 0\np 1 2\n"),
                Set(r#"[render]
object = "o.obj"
"#),
            ],
            "render",
            1,
            "reading the object ./o.obj: the mesh is empty: 0 vertices, 0 triangles, 0 of them without area",
            "export the object as triangles or polygons, with at least one of them",
        ),
        case(
            "vertex NaN",
            &[
                Write("o.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
                Set(r#"[render]
object = "o.obj"
"#),
            ],
            "render",
            1,
            "reading the object ./o.obj: vertex 0 lies at (0, 0, NaN)",
            "repair the mesh (Blender: Mesh > Clean Up) and export it again",
        ),
        case(
            "vertex number out of range",
            &[
                Write("o.obj", "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 7\n"),
                Set(r#"[render]
object = "o.obj"
"#),
            ],
            "render",
            1,
            "reading the object: ./o.obj: not a whole OBJ (face vertex index out of bounds)",
            "export the object again as .glb, .gltf, .obj or .ply",
        ),
        case(
            "all triangles degenerate",
            &[
                Write("o.obj", "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 1 2\n"),
                Set(r#"[render]
object = "o.obj"
"#),
            ],
            "render",
            1,
            "reading the object ./o.obj: the mesh is empty: 2 vertices, 1 triangles, 1 of them without area",
            "export the object as triangles or polygons, with at least one of them",
        ),
        case(
            "object of an unknown format",
            &[
                Write("o.stl", "solid\n"),
                Set(r#"[render]
object = "o.stl"
"#),
            ],
            "render",
            1,
            "reading the object: ./o.stl: has the extension `stl`, expected glb, gltf, obj or ply",
            "export the object again as .glb, .gltf, .obj or .ply",
        ),
        case(
            "object is a picture",
            &[
                Copy("photos/plate_000.jpg", "o.glb"),
                Set(r#"[render]
object = "o.glb"
"#),
            ],
            "render",
            1,
            "reading the object: ./o.glb: not a whole glTF (expected value at line 1 column 1)",
            "export the object again as .glb, .gltf, .obj or .ply",
        ),
        case(
            "outside the scene",
            &[Set("[render]\nposition_m = [50, 0, 0]\n")],
            "render",
            1,
            "placing the object in the scene: object outside the scene: along the world's x it spans #..# m, the scene model #..# m",
            "check `render.position_m` (metres in the grid's frame), `render.scale` and `render.y_up`",
        ),
        case(
            "below the floor",
            &[Set("[render]\nposition_m = [0, 0, -3]\n")],
            "render",
            1,
            "placing the object in the scene: object outside the scene: along the world's y it spans #..# m, the scene model #..# m",
            "check `render.position_m` (metres in the grid's frame), `render.scale` and `render.y_up`",
        ),
        case(
            "outside the view",
            &[Set("[render]\nposition_m = [-0.6, -1.4, 0]\n")],
            "render",
            1,
            "placing the object in the scene: object outside the view: it spans x #..# px, y #..# px, the plate is 640×480 px",
            "check `render.position_m` (metres in the grid's frame), `render.scale` and `render.y_up`",
        ),
    ]);
}

#[test]
fn light_without_a_rectangle_is_sent_to_another_method() {
    const CPU: Spoil = Set("[render]\nmethod = \"occlusion-textures\"\n");
    const GPU: Spoil = Set("[render]\nmethod = \"occlusion-textures\"\nbackend = \"gpu\"\n");
    let hint = "set render.method to \"radiance-transfer\", which takes light of any shape, or give rectangles as \
                render.area_lights";
    let refused = "preparing the shadow method: the scene has no rectangular light: # bright patches, of a rectangle's \
                   shape to # at best";
    check(&[
        case("no rectangular light", &[EvenLight, CPU], "render", 1, refused, hint),
        case("none on the graphics processor", &[EvenLight, GPU], "render", 1, refused, hint),
        case(
            "a given rectangle that is none",
            &[Set(concat!(
                "[render]\nmethod = \"occlusion-textures\"\narea_lights = [{ corner_m = [0, 0, 2], side_u_m = [1, 0, 0], ",
                "side_v_m = [1, 0, 0], radiance = [1, 1, 1] }]\n"
            ))],
            "render",
            1,
            "preparing the shadow method: area light 0 of the settings has sides that are not at right angles",
            "give a corner and two sides at right angles, in metres in the grid's frame, and the radiance where the model has \
             no surface",
        ),
    ]);
}
