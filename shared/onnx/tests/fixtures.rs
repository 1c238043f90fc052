//! The small networks of `tests/models`: what they compute, and what is said where they cannot be used. Needs the library
//! of ONNX Runtime (`scripts/get-onnxruntime`); skipped by name without it.
#![allow(clippy::panic, clippy::unwrap_used)] // helpers of tests are tests

use evpr_core::plan::{Inference, Model, ModelKind, Network, Provider, Sensor};
use evpr_onnx::{DescriptorNetwork, FrameNetwork, Library, OnnxError, Registry, State, sha256_of};
use ndarray::{ArrayD, Axis};
use std::path::{Path, PathBuf};
use std::process::Command;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/models")
}

fn model(id: &str) -> Model {
    let registry = Registry::read(&folder().join("models.toml")).unwrap().unwrap();
    registry.models.into_iter().find(|model| model.id == id).unwrap()
}

fn network(model: Model) -> Network {
    Network {
        model,
        threads: 1,
        batch: None,
    }
}

fn golden(name: &str) -> ArrayD<f32> {
    ndarray_npy::read_npy(folder().join("golden").join(name)).unwrap()
}

/// The library, or a line that says which test is skipped.
fn library(test: &str) -> Option<Library> {
    match Library::load(None) {
        Ok(library) => Some(library),
        Err(OnnxError::NoLibrary) => {
            println!("skipped: {test}: no library of ONNX Runtime (scripts/get-onnxruntime)");
            None
        }
        Err(e) => panic!("{e}"),
    }
}

const SMALL: Sensor = Sensor {
    height: 26,
    width: 35,
};
const TINY: Sensor = Sensor {
    height: 16,
    width: 24,
};

fn descriptors(library: &Library, model: Model, sensor: Sensor) -> Result<DescriptorNetwork, String> {
    DescriptorNetwork::load(library, &network(model), &Inference::default(), Some(sensor), 4)
        .map_err(|e| e.to_string())
}

fn frames(library: &Library, model: Model, sensor: Sensor) -> Result<FrameNetwork, String> {
    FrameNetwork::load(library, &network(model), &Inference::default(), Some(sensor))
        .map_err(|e| e.to_string())
}

fn assert_close(got: &[f32], expected: &ArrayD<f32>) {
    let expected = expected.as_slice().unwrap();
    assert_eq!(got.len(), expected.len());
    let worst = got
        .iter()
        .zip(expected)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max);
    assert!(worst < 1e-5, "they differ by {worst}");
}

#[test]
fn descriptors_are_those_of_the_golden_arrays() {
    let Some(library) = library("descriptors_are_those_of_the_golden_arrays") else {
        return;
    };
    let (images, expected) = (
        golden("tiny_extractor.image.npy"),
        golden("tiny_extractor.descriptor.npy"),
    );
    let mut one = descriptors(&library, model("tiny_extractor"), SMALL).unwrap();
    assert_eq!(
        (one.input_shape(), one.dimension(), one.batch()),
        ((3, 26, 35), 64, 1)
    );
    for (image, expected) in images.axis_iter(Axis(0)).zip(expected.axis_iter(Axis(0))) {
        let image = image.to_owned();
        let got = one.run(image.as_slice().unwrap(), 1).unwrap();
        assert_close(got.get(0), &expected.to_owned());
        assert!(got.get(1).is_empty());
    }
    let two = Network {
        batch: Some(2),
        ..network(model("tiny_extractor"))
    };
    let mut two = DescriptorNetwork::load(&library, &two, &Inference::default(), Some(SMALL), 4).unwrap();
    assert_eq!(two.batch(), 2);
    let got = two.run(images.as_slice().unwrap(), 2).unwrap();
    for (index, expected) in expected.axis_iter(Axis(0)).enumerate() {
        assert_close(got.get(index), &expected.to_owned());
    }
    let image = golden("tiny_fixed.image.npy");
    let mut fixed = descriptors(&library, model("tiny_fixed"), SMALL).unwrap();
    assert_eq!(fixed.input_shape(), (3, 64, 96));
    let got = fixed.run(image.as_slice().unwrap(), 1).unwrap();
    assert_close(got.get(0), &golden("tiny_fixed.descriptor.npy"));
}

#[test]
fn a_memory_is_carried_from_frame_to_frame_until_it_is_reset() {
    let Some(library) = library("a_memory_is_carried_from_frame_to_frame_until_it_is_reset") else {
        return;
    };
    for id in ["tiny_e2vid", "tiny_two_states"] {
        let (voxels, images) = (
            golden(&format!("{id}.voxel.npy")),
            golden(&format!("{id}.image.npy")),
        );
        let mut network = frames(&library, model(id), TINY).unwrap();
        assert!(network.has_memory());
        let mut state = State::default();
        let mut run = |index: usize, state: &mut State| {
            let voxels = voxels.index_axis(Axis(0), index).to_owned();
            let mut image = Vec::new();
            let run = network.run(voxels.as_slice().unwrap(), state, &mut |values| {
                image = values.to_vec()
            });
            run.unwrap();
            image
        };
        for (index, expected) in images.axis_iter(Axis(0)).enumerate() {
            assert_close(&run(index, &mut state), &expected.to_owned());
        }
        state.reset();
        assert_close(&run(0, &mut state), &images.index_axis(Axis(0), 0).to_owned());
    }
    let mut stateless = frames(&library, model("tiny_e2vid_stateless"), TINY).unwrap();
    assert!(!stateless.has_memory());
    let expected = golden("tiny_e2vid_stateless.image.npy");
    let voxels = golden("tiny_e2vid_stateless.voxel.npy");
    let mut state = State::default();
    for (voxels, expected) in voxels.axis_iter(Axis(0)).zip(expected.axis_iter(Axis(0))) {
        let voxels = voxels.to_owned();
        let take = &mut |values: &[f32]| assert_close(values, &expected.to_owned());
        stateless
            .run(voxels.as_slice().unwrap(), &mut state, take)
            .unwrap();
    }
}

#[test]
fn a_grid_is_padded_to_the_network_s_multiple() {
    let Some(library) = library("a_grid_is_padded_to_the_network_s_multiple") else {
        return;
    };
    let sensor = Sensor {
        height: 10,
        width: 24,
    };
    assert_eq!(
        frames(&library, model("tiny_e2vid"), sensor)
            .unwrap()
            .input_shape(),
        (5, 16, 24)
    );
}

/// A copy of a model whose file was changed; its hash is as the registry has it, or of the new file.
fn changed(id: &str, change: impl Fn(&mut Vec<u8>), rehash: bool) -> (tempfile::TempDir, Model) {
    let folder = tempfile::tempdir().unwrap();
    let mut model = model(id);
    let mut bytes = std::fs::read(&model.file).unwrap();
    change(&mut bytes);
    model.file = folder.path().join("changed.onnx");
    std::fs::write(&model.file, bytes).unwrap();
    if rehash {
        model.sha256 = sha256_of(&model.file).unwrap();
    }
    (folder, model)
}

#[test]
fn what_is_wrong_with_a_model_is_said_in_one_line() {
    let Some(library) = library("what_is_wrong_with_a_model_is_said_in_one_line") else {
        return;
    };
    let says = |model: Model, sensor: Sensor, expected: &str| {
        let problem = match &model.kind {
            ModelKind::Extractor { .. } => descriptors(&library, model, sensor).err(),
            ModelKind::Reconstruction { .. } => frames(&library, model, sensor).err(),
        };
        let problem = problem.unwrap_or_default();
        assert!(problem.contains(expected), "{problem}\nlacks: {expected}");
        assert!(!problem.contains('\n'), "{problem}");
    };
    says(model("wrong_dim"), SMALL, "it gives descriptor [");
    says(
        model("nan"),
        SMALL,
        "of its descriptor is none (NaN); export it again",
    );
    says(model("contradiction"), SMALL, "the file says mean = ");
    says(model("opset_too_new"), SMALL, "ONNX Runtime cannot load it: ");
    let mut gone = model("tiny_extractor");
    gone.file = folder().join("gone.onnx");
    says(
        gone,
        SMALL,
        "gone.onnx: there is no such file; put it there (its weights: random weights of",
    );
    let (_folder, tampered) = changed("tiny_extractor", |bytes| bytes[1000] ^= 1, false);
    says(tampered, SMALL, "its SHA-256 is ");
    let (_folder, cut) = changed("tiny_extractor", |bytes| bytes.truncate(5000), false);
    says(cut, SMALL, "it is cut short or another file");
    let (_folder, cut) = changed("tiny_extractor", |bytes| bytes.truncate(5000), true);
    says(cut, SMALL, "ONNX Runtime cannot load it: ");
    let mut other = model("tiny_extractor");
    other.output = "image_features".to_owned();
    says(
        other,
        SMALL,
        "it has no output \"image_features\", but descriptor",
    );
    let native = Model {
        kind: model("tiny_extractor").kind,
        ..model("tiny_fixed")
    };
    says(native, SMALL, "the file says input_size = \"64x96\"");
    let mut bins = model("tiny_e2vid");
    if let ModelKind::Reconstruction { bins, .. } = &mut bins.kind {
        *bins = 6;
    }
    says(bins, TINY, "the file says bins = \"5\", and the registry \"6\"");
}

#[test]
fn an_input_of_another_shape_is_refused() {
    let Some(library) = library("an_input_of_another_shape_is_refused") else {
        return;
    };
    // Not even the metadata say what it takes.
    let strip = |bytes: &mut Vec<u8>| {
        let at = bytes.windows(15).position(|w| w == b"evpr.input_size").unwrap();
        bytes[at] = b'x';
        let at = bytes.windows(11).position(|w| w == b"evpr.resize").unwrap();
        bytes[at] = b'x';
    };
    let (_folder, fixed) = changed("tiny_fixed", strip, true);
    let native = Model {
        kind: model("tiny_extractor").kind,
        ..fixed
    };
    let problem = descriptors(&library, native, SMALL).unwrap_err();
    assert!(
        problem.contains("[1, 3, 64, 96], and here images are [1, 3, 26, 35]"),
        "{problem}"
    );
}

#[test]
fn a_provider_that_cannot_start_is_an_error_unless_another_may_take_over() {
    let Some(library) = library("a_provider_that_cannot_start_is_an_error_unless_another_may_take_over")
    else {
        return;
    };
    let inference = Inference {
        providers: vec![Provider::Cuda, Provider::Cpu],
        ..Inference::default()
    };
    let load = |inference: &Inference| {
        DescriptorNetwork::load(&library, &network(model("tiny_extractor")), inference, None, 1)
    };
    match load(&inference) {
        Ok(network) => {
            assert_eq!(network.loaded().provider, Provider::Cuda);
            println!("skipped: the rest: this machine has CUDA");
            return;
        }
        Err(e) => {
            let problem = e.to_string();
            assert!(
                problem.contains("the provider \"cuda\" cannot start: "),
                "{problem}"
            );
            assert!(
                problem.contains("inference.fallback = true") && !problem.contains('\n'),
                "{problem}"
            );
        }
    }
    let fallback = Inference {
        fallback: true,
        ..inference
    };
    assert_eq!(load(&fallback).unwrap().loaded().provider, Provider::Cpu);
}

#[test]
fn more_than_one_image_at_a_time_needs_a_network_that_takes_them() {
    let Some(library) = library("more_than_one_image_at_a_time_needs_a_network_that_takes_them") else {
        return;
    };
    let network = Network {
        batch: Some(3),
        ..network(model("tiny_fixed"))
    };
    let problem =
        DescriptorNetwork::load(&library, &network, &Inference::default(), Some(SMALL), 4).unwrap_err();
    assert!(
        problem.to_string().contains("it takes one image at a time"),
        "{problem}"
    );
}

/// A library that says it is ONNX Runtime 1.2: what an old one looks like.
#[test]
fn a_library_too_old_is_named_with_its_version() {
    const SOURCE: &str = "#include <stddef.h>\n\
        typedef struct { const void* (*GetApi)(unsigned); const char* (*GetVersionString)(void); } Base;\n\
        static const void* api(unsigned v) { (void)v; return NULL; }\n\
        static const char* version(void) { return \"1.2.0\"; }\n\
        static const Base base = { api, version };\n\
        const Base* OrtGetApiBase(void) { return &base; }\n";
    let folder = tempfile::tempdir().unwrap();
    let (source, old) = (folder.path().join("old.c"), folder.path().join("libold.so"));
    std::fs::write(&source, SOURCE).unwrap();
    let compiled = Command::new("cc")
        .args(["-shared", "-fPIC", "-o"])
        .arg(&old)
        .arg(&source)
        .status();
    if !compiled.is_ok_and(|status| status.success()) {
        println!("skipped: a_library_too_old_is_named_with_its_version: no C compiler");
        return;
    }
    let problem = Library::load(Some(&old)).unwrap_err().to_string();
    assert!(
        problem
            .contains("libold.so: is ONNX Runtime 1.2.0, and 1.24 is the least; run scripts/get-onnxruntime"),
        "{problem}"
    );
}
