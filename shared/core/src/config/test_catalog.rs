//! A catalog for tests: what the kinds of the real one look like, without the code behind them.

use crate::message::ChannelOrder;
use crate::plan::{
    Catalog, Color, ExtractorKind, InputSize, Model, ModelKind, Models, ParamInfo, ParamKind, Params,
    Preprocessing, ReconstructionKind, Resize,
};
use std::sync::OnceLock;

const fn side(name: &'static str, default: i64, doc: &'static str) -> ParamInfo {
    ParamInfo {
        name,
        kind: ParamKind::Integer {
            default,
            min: 1,
            max: 256,
        },
        doc,
    }
}

const TAU: ParamInfo = ParamInfo {
    name: "tau",
    kind: ParamKind::Duration {
        default_ns: 100_000_000,
    },
    doc: "Time constant of the decay.",
};

const TRANSFORM: ParamInfo = ParamInfo {
    name: "transform",
    kind: ParamKind::Choice {
        default: "none",
        options: &["none", "log1p"],
    },
    doc: "Applied to each pixel after resizing.",
};

fn patch_norm_dim(params: &Params) -> Result<usize, String> {
    let (side, patch) = (params.integer("side"), params.integer("patch"));
    if patch < 1 || side % patch != 0 {
        return Err(format!(
            "side {side} is not a multiple of patch {patch}; write one that is"
        ));
    }
    Ok((side * side) as usize)
}

fn raw_pixels_dim(params: &Params) -> Result<usize, String> {
    Ok((params.integer("height") * params.integer("width")) as usize)
}

const RECONSTRUCTIONS: &[ReconstructionKind] = &[
    ReconstructionKind {
        name: "event_count",
        doc: "Counts per polarity.",
        channel_order: ChannelOrder::OffOnZero,
        params: &[],
        masks_hot_pixels: false,
    },
    ReconstructionKind {
        name: "event_count_no_polarity",
        doc: "Counts of both polarities.",
        channel_order: ChannelOrder::Grey,
        params: &[],
        masks_hot_pixels: false,
    },
    ReconstructionKind {
        name: "time_surface",
        doc: "Time since the last event.",
        channel_order: ChannelOrder::OnOffZero,
        params: &[TAU],
        masks_hot_pixels: false,
    },
    ReconstructionKind {
        name: "frames",
        doc: "Frames as they are.",
        channel_order: ChannelOrder::BlueGreenRed,
        masks_hot_pixels: false,
        params: &[],
    },
];

const EXTRACTORS: &[ExtractorKind] = &[
    ExtractorKind {
        name: "patch_norm",
        doc: "Patch-normalised pixels.",
        params: &[
            side("side", 32, "Side, pixels."),
            side("patch", 8, "Side of a patch, pixels."),
        ],
        dim: patch_norm_dim,
    },
    ExtractorKind {
        name: "raw_pixels",
        doc: "Pixels.",
        params: &[
            side("height", 24, "Rows."),
            side("width", 32, "Columns."),
            TRANSFORM,
        ],
        dim: raw_pixels_dim,
    },
    ExtractorKind {
        name: "hog",
        doc: "Edges per direction and cell.",
        params: &[],
        dim: |_| Ok(688),
    },
];

/// The networks `mixvpr` and `e2vid`.
fn models() -> Vec<Model> {
    let model = |id: &str, output: &str, kind| Model {
        id: id.to_owned(),
        file: format!("models/{id}.onnx").into(),
        sha256: "0123456789abcdef".repeat(4),
        output: output.to_owned(),
        kind,
        licence: "MIT".to_owned(),
        source: "nowhere".to_owned(),
    };
    let extractor = ModelKind::Extractor {
        preprocessing: Preprocessing {
            input: InputSize::Native,
            resize: Resize::None,
            color: Color::Rgb,
            range: 1.0,
            mean: vec![0.485, 0.456, 0.406],
            std: vec![0.229, 0.224, 0.225],
        },
        dimension: 4096,
    };
    let reconstruction = ModelKind::Reconstruction {
        bins: 5,
        multiple: 8,
        states: vec!["h0".to_owned(), "c0".to_owned()],
    };
    vec![
        model("mixvpr", "descriptor", extractor),
        model("e2vid", "image", reconstruction),
    ]
}

/// Kinds named like those of the stages' crates: `event_count`, `event_count_no_polarity`, `time_surface`,
/// `frames`, `patch_norm`, `raw_pixels` and `hog`; the networks `mixvpr` and `e2vid`; and three cores.
#[doc(hidden)]
pub fn test_catalog() -> Catalog<'static> {
    static MODELS: OnceLock<Vec<Model>> = OnceLock::new();
    Catalog {
        reconstructions: RECONSTRUCTIONS,
        extractors: EXTRACTORS,
        models: Models {
            models: MODELS.get_or_init(models),
            registry: "models/models.toml",
        },
        cores: 3,
    }
}
