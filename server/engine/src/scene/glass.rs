//! Whether glass is a body: light that enters it can leave it again.

use std::collections::{BTreeSet, HashMap};

use glam::{DVec3, Vec3};

use super::{Id, Mesh, Scene, Warning};

/// Of the length of all edges of a body, those that belong to one face alone: slivers that were left out leave some.
const OPEN_SHARE: f64 = 0.01;
/// Corners are one where they lie in the same of so many places along a mesh, some float steps wide: sines of half a turn are not quite zero.
const PLACES: f64 = (1 << 22) as f64;

/// What of a mesh is glass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Glass {
    /// A body, or several.
    Closed,
    /// Its faces look inwards.
    InsideOut,
    /// Some edges have a face on one side alone.
    Open,
}

impl Scene {
    /// What of the glass that nodes show is no body with its faces outwards, mesh by mesh. Such a scene is valid: water in a basin is open
    /// where it meets the basin. Takes time in proportion to the triangles of glass.
    pub fn odd_glass(&self) -> Vec<Warning> {
        let shown: BTreeSet<&Id> = self.nodes().values().filter_map(|node| node.mesh.as_ref()).collect();
        let is_glass = |material: &Id| {
            self.materials().get(material).is_some_and(|material| material.transmission > 0.0)
        };
        let told = |(id, mesh): (&Id, &std::sync::Arc<Mesh>)| {
            let message = match glass_of(mesh, is_glass)? {
                Glass::Closed => return None,
                Glass::InsideOut => {
                    "is glass with its faces inwards, and shows air in glass: reverse the order of their corners"
                }
                Glass::Open => {
                    "is glass with open edges: what enters it stays in glass until it meets glass again; a pane takes two faces, \
                     and edges between them"
                }
            };
            Some(Warning { object: format!("mesh {id:?}"), message: message.into() })
        };
        self.meshes().iter().filter(|(id, _)| shown.contains(id)).filter_map(told).collect()
    }
}

/// `None` where there is none.
fn glass_of(mesh: &Mesh, is_glass: impl Fn(&Id) -> bool) -> Option<Glass> {
    let of_primitives = mesh.primitives().iter().filter(|primitive| is_glass(&primitive.material));
    let triangles: Vec<[Vec3; 3]> = of_primitives
        .flat_map(|primitive| {
            let first = primitive.first_triangle as usize;
            &mesh.triangles()[first..first + primitive.triangle_count as usize]
        })
        .map(|corners| corners.map(|corner| mesh.positions()[corner as usize]))
        .collect();
    if triangles.is_empty() {
        return None;
    }
    // By position: faces with normals of their own share no corners. How often each edge is gone along one way more than the other.
    let mut surplus: HashMap<[[i32; 3]; 2], (i32, f64)> = HashMap::new();
    let per_m = PLACES / (mesh.bounds().max - mesh.bounds().min).max_element();
    let mut all_m = 0.0;
    let mut volume_m3 = 0.0;
    for corners in &triangles {
        let [a, b, c] = corners.map(Vec3::as_dvec3);
        volume_m3 += a.dot(b.cross(c)) / 6.0;
        for (from, to) in [(corners[0], corners[1]), (corners[1], corners[2]), (corners[2], corners[0])] {
            let length_m = DVec3::from(from).distance(DVec3::from(to));
            all_m += length_m;
            let [from, to] =
                [from, to].map(|corner| (corner.as_dvec3() * per_m).round().as_ivec3().to_array());
            let (edge, way) = if from < to { ([from, to], 1) } else { ([to, from], -1) };
            let (count, _) = surplus.entry(edge).or_insert((0, length_m));
            *count += way;
        }
    }
    // The order of a map changes the last digits of the sum alone.
    let open_m: f64 =
        surplus.values().map(|(count, length_m)| f64::from(count.unsigned_abs()) * length_m).sum();
    Some(match open_m > OPEN_SHARE * all_m {
        true => Glass::Open,
        false if volume_m3 < 0.0 => Glass::InsideOut,
        false => Glass::Closed,
    })
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::*;
    use crate::scene::{
        Material, MeshSource,
        samples::{Stage, cornell_box, cuboid, glazed_room, quad, sphere},
    };

    fn told_of(mesh: impl FnOnce(&Id) -> MeshSource, transmission: f32) -> Vec<Warning> {
        let mut stage = Stage::default();
        let material = Material { transmission, roughness: 0.0, ..Material::default() };
        let material = stage.material("material", material).unwrap();
        stage.place("thing", mesh(&material), DAffine3::IDENTITY).unwrap();
        stage.finish().odd_glass()
    }

    fn cube(material: &Id) -> MeshSource {
        cuboid(DVec3::splat(-1.0), DVec3::new(1.0, 2.0, 0.5), material)
    }

    /// Bodies are in order, whatever they share corners with and wherever they stand; sheets, boxes with a side gone and what faces
    /// inwards are not, if they are glass.
    #[test]
    fn bodies_of_glass_are_told_from_sheets() {
        let apart = |material: &Id| {
            let mut mesh = cube(material);
            mesh.positions =
                mesh.triangles.iter().flatten().map(|corner| mesh.positions[*corner as usize]).collect();
            mesh.triangles =
                (0..mesh.triangles.len() as u32).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
            mesh
        };
        let far = |material: &Id| cuboid(DVec3::splat(1e5), DVec3::splat(1e5 + 0.5), material);
        let ball = |material: &Id| {
            let mut mesh = sphere(DVec3::ZERO, 1.0, 24, material);
            // As if worked out by a sine that is not quite zero, for each corner another.
            for (number, position) in mesh.positions.iter_mut().enumerate() {
                *position += DVec3::new(number as f64, 0.0, -(number as f64)) * 1e-18;
            }
            mesh
        };
        for told in [told_of(cube, 1.0), told_of(apart, 0.5), told_of(far, 1.0), told_of(ball, 1.0)] {
            assert_eq!(told, []);
        }
        assert!(
            glazed_room().unwrap().odd_glass().is_empty() && cornell_box().unwrap().odd_glass().is_empty()
        );
        let sheet = |material: &Id| {
            let v = DVec3::new;
            quad([v(0., 0., 0.), v(1., 0., 0.), v(1., 1., 0.), v(0., 1., 0.)], material)
        };
        let without_a_side = |material: &Id| {
            let mut mesh = cube(material);
            mesh.triangles.truncate(10);
            mesh.primitives[0].triangle_count = 10;
            mesh
        };
        let inwards = |material: &Id| {
            let mut mesh = cube(material);
            mesh.triangles.iter_mut().for_each(|corners| corners.swap(1, 2));
            mesh
        };
        for (told, word) in [
            (told_of(sheet, 1.0), "open edges"),
            (told_of(without_a_side, 1.0), "open edges"),
            (told_of(inwards, 1.0), "inwards"),
        ] {
            assert!(told.len() == 1 && told[0].message.contains(word), "{told:?}");
            assert_eq!(told[0].object, "mesh \"thing\"");
        }
        assert_eq!(told_of(sheet, 0.0), []);
    }
}
