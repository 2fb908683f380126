//! Embree, as a program of its own beside the bench; `embree.cpp` says what it understands.

use std::{
    fs::File,
    io::{self, BufRead, BufReader, BufWriter, Read, Write},
    path::Path,
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
};

use lumicast_engine::accel::Ray;
use tempfile::TempDir;

use crate::{
    answer::{Answer, Timed},
    ours::RenderMesh,
    ray_set::{Kind, RaySet},
};

const SOURCE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/rays/embree.cpp");

/// How many rays it is asked at once.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Width {
    One,
    Eight,
}

impl Width {
    pub(crate) const ALL: [Width; 2] = [Width::One, Width::Eight];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Width::One => "Embree-1",
            Width::Eight => "Embree-8",
        }
    }

    fn rays(self) -> usize {
        match self {
            Width::One => 1,
            Width::Eight => 8,
        }
    }
}

/// The running program, which ends with its input.
pub(crate) struct Embree {
    child: Child,
    commands: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
    _folder: TempDir,
}

/// What building took and holds.
pub(crate) struct Built {
    pub(crate) seconds: f64,
    pub(crate) bytes: f64,
}

/// What Embree says of its tree.
pub(crate) struct Description {
    /// Such as `BVH8<triangle4>`: its width and what its leaves hold.
    pub(crate) kind: String,
    pub(crate) sah_cost: f64,
}

impl Embree {
    /// Compiles and starts the program with this mesh and these rays; `None`, having said why, where that cannot be.
    pub(crate) fn start(mesh: &RenderMesh, rays: &RaySet) -> Option<Embree> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let program = folder.path().join("embree");
        let compiled = Command::new("g++")
            .args(["-std=c++17", "-O3", "-march=native", SOURCE, "-o"])
            .arg(&program)
            .args(["-lembree3", "-lpthread"])
            .output();
        match compiled {
            Ok(output) if output.status.success() => {}
            Ok(output) => {
                println!("\nSKIPPED Embree: apt-get install libembree-dev g++");
                eprintln!("{}", String::from_utf8_lossy(&output.stderr));
                return None;
            }
            Err(error) => {
                println!("\nSKIPPED Embree: apt-get install libembree-dev g++ ({error})");
                return None;
            }
        }
        let file = folder.path().join("subject");
        write_subject(&file, mesh, rays).expect("room for a temporary file");
        let mut child = Command::new(&program)
            .arg(&file)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("a program just built starts");
        let commands = child.stdin.take();
        let answers = BufReader::new(child.stdout.take().expect("its output is piped"));
        Some(Embree { child, commands, answers, _folder: folder })
    }

    /// Builds the tree anew with so many threads; queries ask the last one built.
    pub(crate) fn build(&mut self, threads: usize) -> Built {
        let (_, numbers) = self.ask(&format!("build {threads}"));
        let [seconds, bytes] = numbers[..] else { panic!("a build is answered by {numbers:?}") };
        Built { seconds, bytes }
    }

    pub(crate) fn query(&mut self, kind: Kind, width: Width, threads: usize) -> Timed {
        let (_, numbers) = self.ask(&format!("query {} {} {threads}", kind as usize, width.rays()));
        let [seconds, hit_count, t_sum] = numbers[..] else { panic!("a query is answered by {numbers:?}") };
        Timed { seconds, answer: Answer { hit_count: hit_count as usize, t_sum } }
    }

    /// Kind and cost of the tree from Embree's own statistics; `None` when another version words them differently.
    pub(crate) fn describe(&mut self) -> Option<Description> {
        let (lines, _) = self.ask("describe");
        // "finished BVH8<triangle4> : 16.252ms, …" and "total            : sah =  25.031 (100.00%), …".
        let kind =
            lines.iter().find_map(|line| line.trim().strip_prefix("finished ")?.split_whitespace().next())?;
        let cost = lines.iter().filter(|line| line.trim().starts_with("total"));
        let mut cost = cost.filter_map(|line| line.split("sah =").nth(1)?.split_whitespace().next());
        Some(Description { kind: kind.to_string(), sah_cost: cost.next()?.parse().ok()? })
    }

    /// The lines before the answer, and the numbers in it.
    fn ask(&mut self, command: &str) -> (Vec<String>, Vec<f64>) {
        let commands = self.commands.as_mut().expect("open until dropped");
        writeln!(commands, "{command}").expect("the program reads on");
        let mut lines = Vec::new();
        for line in self.answers.by_ref().lines() {
            let line = line.expect("text");
            if let Some(numbers) = line.strip_prefix("answer") {
                let numbers = numbers.split_whitespace().map(|word| word.parse().expect("a number"));
                return (lines, numbers.collect());
            }
            lines.push(line);
        }
        panic!("the Embree program ended over {command:?}");
    }
}

impl Drop for Embree {
    fn drop(&mut self) {
        // The end of its input is the end of the program.
        self.commands = None;
        if let Err(error) = self.child.wait() {
            eprintln!("Embree: {error}");
        }
    }
}

/// The layout is that of `embree.cpp`.
fn write_subject(path: &Path, mesh: &RenderMesh, rays: &RaySet) -> io::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    let sets = Kind::ALL.map(|kind| rays.of(kind));
    let mut put = |bytes: [u8; 4]| file.write_all(&bytes);
    let counts = [mesh.positions.len(), mesh.triangles.len()];
    for count in counts.into_iter().chain(sets.map(<[Ray]>::len)) {
        put((count as u32).to_le_bytes())?;
    }
    for coordinate in mesh.positions.iter().flat_map(|position| position.to_array()) {
        put(coordinate.to_le_bytes())?;
    }
    for vertex in mesh.triangles.iter().flatten() {
        put(vertex.to_le_bytes())?;
    }
    for ray in sets.into_iter().flatten() {
        let [ox, oy, oz] = ray.origin.to_array();
        let [dx, dy, dz] = ray.direction.to_array();
        for number in [ox, oy, oz, ray.t_max, dx, dy, dz, 0.0] {
            put(number.to_le_bytes())?;
        }
    }
    file.flush()
}
