use super::*;
use lumicast_engine::scene::{Environment, Scene, Texels, samples};
use lumicast_protocol::EditBatch;

fn after(json: &str) -> Result<Scene, wire::Problem> {
    let edits = EditBatch::from_json(json.as_bytes()).unwrap().edits;
    let limits = EditLimits { edits_per_batch: 100, ..EditLimits::default() };
    apply(&samples::cornell_box().unwrap(), &edits, &limits).map(|applied| applied.scene)
}

/// Ids that one side takes the other takes too, unchanged.
#[test]
fn both_kinds_of_id_follow_one_rule() {
    assert_eq!(wire::id::ID_BYTES_MAX, scene::Id::BYTES_MAX);
    for text in ["a", "Säule 3 / ⊙", &"x".repeat(128), &"é".repeat(64)] {
        let wire = wire::Id::new(text).unwrap();
        assert_eq!(id(&wire).as_str(), text);
        assert_eq!(wire_id(&id(&wire)), wire);
    }
    for text in ["", "a\nb", &"x".repeat(129)] {
        assert!(wire::Id::new(text).is_err() && scene::Id::new(text).is_none());
    }
}

/// The wire's middle column looks down −Z, the engine's first: the picture is turned by half, whatever its width.
#[test]
fn the_middle_column_of_an_environment_becomes_the_first() {
    for width in [2_usize, 3, 4] {
        let values: Vec<u8> =
            (0..width).flat_map(|column| [column as f32; 3]).flat_map(f32::to_le_bytes).collect();
        let image = wire::EnvironmentImage { width: width as u32, height: 1, texels: values };
        let edit =
            wire::Edit::SetEnvironment(wire::SetEnvironment::Image { image, scale: 1.0, rotation_rad: 0.0 });
        let limits = EditLimits { edits_per_batch: 1, ..EditLimits::default() };
        let scene = apply(&Scene::default(), &[edit], &limits).unwrap().scene;
        let Environment::Image { texture, .. } = scene.environment() else { panic!("no picture") };
        let texture = &scene.textures()[texture];
        let Texels::Rgba32F(texels) = &texture.texels else { panic!("no floats") };
        let first = texels[0][0];
        // The column that holds the direction at half the width.
        assert_eq!(first, (width / 2) as f32, "width {width}");
    }
}

/// A scene told and set again is the same scene.
#[test]
fn what_is_described_can_be_sent_back() {
    let json = r#"[
        {"op":"add_light","light":"s","kind":"spot","intensity":[1,2,3],"position":[1,2,3],"direction":[0,-2,0],"inner_angle_rad":0.1,"outer_angle_rad":0.3},
        {"op":"add_light","light":"d","kind":"directional","irradiance":[1,2,3],"direction":[0,-1,0]},
        {"op":"set_material","material":"white","attenuation_distance_m":0.5,"alpha_cutoff":0.25}]"#;
    let scene = after(json).unwrap();
    let id = wire::SceneId::new("s").unwrap();
    let told = describe(&scene, &id, "s", 1, false);
    let mut edits: Vec<wire::Edit> = Vec::new();
    for node in &told.nodes {
        let (node, transform) = (node.id.clone(), node.transform);
        edits.push(wire::Edit::SetTransform(wire::SetTransform { node, transform }));
    }
    for light in &told.lights {
        edits.push(wire::Edit::RemoveLight(wire::RemoveLight { light: light.id.clone() }));
        let (light, parent, source) = (light.id.clone(), light.parent.clone(), light.source);
        edits.push(wire::Edit::AddLight(wire::AddLight { light, parent, source }));
    }
    let limits = EditLimits { edits_per_batch: 100, ..EditLimits::default() };
    let again = apply(&scene, &edits, &limits).unwrap().scene;
    assert_eq!(describe(&again, &id, "s", 1, false), told);
    assert_eq!(told.lights[1].source.kind(), wire::LightKind::Spot);
}

/// A matrix that is written row by row is recognised by its last row, not silently turned around.
#[test]
fn a_row_major_matrix_is_refused() {
    let edit =
        r#"[{"op":"set_transform","node":"lamp","transform":{"matrix":[1,0,0,5,0,1,0,0,0,0,1,0,0,0,0,1]}}]"#;
    let problem = after(edit).unwrap_err();
    assert_eq!(problem.field.as_deref(), Some("transform"));
    assert!(problem.detail.contains("row"), "{}", problem.detail);
}

/// A file that is to hang under a node that is not there: `parent` is at fault, not the file.
#[test]
fn a_file_under_an_unknown_node_blames_its_parent() {
    // Bytes that are no glTF: the parent is looked at first.
    let problem = after(r#"[{"op":"load_gltf","data":"AAAA","parent":"nobody"}]"#).unwrap_err();
    assert_eq!((problem.op.as_deref(), problem.field.as_deref()), (Some("load_gltf"), Some("parent")));
    assert!(problem.detail.contains("there is no node \"nobody\""), "{}", problem.detail);
    let problem = after(r#"[{"op":"load_gltf","data":"AAAA","parent":"lamp"}]"#).unwrap_err();
    assert_eq!(problem.field.as_deref(), Some("data"));
}

/// Axes too long have no inverse that is of use, as those of no length have none.
#[test]
fn a_scale_beyond_reason_is_told_its_bounds() {
    for scale in ["1e30", "1e-30", "0"] {
        let edit = format!(
            r#"[{{"op":"set_transform","node":"lamp","transform":{{"scale":[{scale},{scale},{scale}]}}}}]"#
        );
        let problem = after(&edit).unwrap_err();
        assert_eq!(problem.field.as_deref(), Some("transform"));
        assert!(problem.detail.contains("axes from 1e-12 to 1e12 long"), "{}", problem.detail);
    }
}

/// A pose far out, without axes or squashed flat is a problem, never a picture of nothing.
#[test]
fn a_bad_pose_is_refused() {
    let pose = |matrix: [f64; 16]| {
        let projection = wire::Projection::Perspective { yfov_rad: 1.0 };
        view_of_pose(&wire::CameraPose { world_from_camera: matrix, projection })
    };
    let identity = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.];
    assert!(pose(identity).is_ok());
    for (index, value) in [(0, 0.0), (5, 1e-9), (12, 1e12), (3, 1.0), (10, f64::NAN)] {
        let mut matrix = identity;
        matrix[index] = value;
        assert!(pose(matrix).is_err(), "element {index} = {value}");
    }
}
