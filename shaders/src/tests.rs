//! Every step is WGSL that any WebGPU device takes.

use std::collections::BTreeSet;

use naga::valid::{Capabilities, ValidationFlags, Validator};

use crate::{Constant, Overlap, PROOF_CONSTANTS, RASTERS, STEPS};

/// The module that a source makes on every device: parsed, and validated without optional capabilities.
fn module_of(name: &str, source: &str) -> naga::Module {
    let module = naga::front::wgsl::parse_str(source)
        .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(source)));
    let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
    if let Err(error) = validator.validate(&module) {
        panic!("{name}: {}", error.emit_to_string(source));
    }
    module
}

fn entry_points_of(module: &naga::Module) -> Vec<&str> {
    module.entry_points.iter().map(|entry| entry.name.as_str()).collect()
}

/// Parses, validates without optional capabilities, and runs in workgroups of the size that Rust believes.
#[test]
fn every_step_is_valid_on_every_device() {
    for step in STEPS {
        let module = module_of(step.name, &step.source(PROOF_CONSTANTS));
        assert_eq!(entry_points_of(&module), [step.entry_point], "{} has one entry point", step.name);
        assert_eq!(module.entry_points[0].workgroup_size, step.workgroup_size, "{}", step.name);
    }
}

/// The same for what is drawn, by one vertex and one fragment shader.
#[test]
fn everything_drawn_is_valid_on_every_device() {
    for raster in RASTERS {
        let module = module_of(raster.name, &raster.source(PROOF_CONSTANTS));
        assert_eq!(entry_points_of(&module), [raster.vertex, raster.fragment], "{}", raster.name);
        let stages: Vec<_> = module.entry_points.iter().map(|entry| entry.stage).collect();
        assert_eq!(stages, [naga::ShaderStage::Vertex, naga::ShaderStage::Fragment], "{}", raster.name);
        let kind = match raster.overlap {
            Overlap::Nearest => Some(naga::ScalarKind::Uint),
            Overlap::Sum => Some(naga::ScalarKind::Float),
            Overlap::Nearness => None,
        };
        let result = module.entry_points[1].function.result.as_ref().map(|result| result.ty);
        let shown = result.map(|ty| module.types[ty].inner.clone());
        let four = |kind| naga::TypeInner::Vector {
            size: naga::VectorSize::Quad,
            scalar: naga::Scalar { kind, width: 4 },
        };
        assert_eq!(shown, kind.map(four), "{}", raster.name);
    }
}

#[test]
fn names_are_used_once() {
    let names = || STEPS.iter().map(|step| step.name).chain(RASTERS.iter().map(|raster| raster.name));
    assert_eq!(names().collect::<BTreeSet<_>>().len(), names().count());
    let constants: BTreeSet<_> = PROOF_CONSTANTS.iter().map(|(name, _)| name).collect();
    assert_eq!(constants.len(), PROOF_CONSTANTS.len());
}

/// A constant reaches the shader as the same bits.
#[test]
fn constants_keep_their_value() {
    for value in [0.0, -0.0, 1.0, -1.5, 1e-12, f32::MAX, f32::MIN_POSITIVE, f32::EPSILON, 16_777_217.0] {
        let source = Constant::F32(value).declaration("X");
        let module = naga::front::wgsl::parse_str(&source).unwrap();
        let (_, constant) = module.constants.iter().next().unwrap();
        let naga::Expression::Literal(naga::Literal::F32(read)) = module.global_expressions[constant.init]
        else {
            panic!("{source} is no literal");
        };
        assert_eq!(read.to_bits(), value.to_bits(), "{source}");
    }
    assert_eq!(Constant::U32(u32::MAX).declaration("A"), "const A: u32 = 4294967295u;\n");
    assert_eq!(Constant::Bool(false).declaration("B"), "const B: bool = false;\n");
    assert_eq!(Constant::I32(-3).declaration("C"), "const C: i32 = -3;\n");
}
