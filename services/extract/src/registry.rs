//! The kinds there are: one row each.

use crate::hog;
use crate::kind::Make;
use crate::patch_norm::PatchNorm;
use crate::raw_pixels::RawPixels;
use evpr_core::plan::{ExtractorKind, ParamInfo, ParamKind};

/// A kind with its description.
pub(crate) struct Row {
    /// What the configuration and a person need to know.
    pub(crate) kind: ExtractorKind,
    /// How to make one.
    pub(crate) make: Make,
}

/// A length in pixels of the small image that a kind works on.
const fn pixels(name: &'static str, default: i64, doc: &'static str) -> ParamInfo {
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

const ROWS: [Row; 3] = [
    Row {
        kind: ExtractorKind {
            name: "patch_norm",
            doc: "a small image whose patches each have mean 0 and standard deviation 1",
            params: &[
                pixels("side", 32, "height and width of the small image, pixels"),
                pixels("patch", 8, "height and width of a patch, pixels; divides side"),
            ],
            dim: PatchNorm::dim,
        },
        make: |sensor, params| Box::new(PatchNorm::new(sensor, params)),
    },
    Row {
        kind: ExtractorKind {
            name: "raw_pixels",
            doc: "a small image with mean 0 and standard deviation 1",
            params: &[
                pixels("height", 24, "height of the small image, pixels"),
                pixels("width", 32, "width of the small image, pixels"),
                ParamInfo {
                    name: "transform",
                    kind: ParamKind::Choice {
                        default: "none",
                        options: &["none", "log1p"],
                    },
                    doc: "what each pixel of the small image passes through: none, or log(1 + value)",
                },
            ],
            dim: RawPixels::dim,
        },
        make: |sensor, params| Box::new(RawPixels::new(sensor, params)),
    },
    Row {
        kind: ExtractorKind {
            name: "hog",
            doc: "edges of 8 directions in 8×10 and 2×3 cells of a small image; stands shifts, light and noise",
            params: &[],
            dim: |_| Ok(hog::DIM),
        },
        make: |sensor, _| Box::new(hog::Hog::new(sensor)),
    },
];

/// The kinds that this crate knows, as the configuration and `--help` show them.
pub static KINDS: [ExtractorKind; ROWS.len()] = {
    let mut kinds = [ROWS[0].kind; ROWS.len()];
    let mut row = 1;
    while row < ROWS.len() {
        kinds[row] = ROWS[row].kind;
        row += 1;
    }
    kinds
};

/// The kinds that this crate knows: [`KINDS`] as a slice.
pub fn kinds() -> &'static [ExtractorKind] {
    &KINDS
}

/// The row of the kind of this name.
pub(crate) fn find(name: &str) -> Option<Row> {
    ROWS.into_iter().find(|row| row.kind.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_core::plan::{ParamValue, Params};

    fn defaults(kind: &ExtractorKind) -> Params {
        let all = kind.params.iter();
        Params(all.map(|p| (p.name.to_owned(), p.default_value())).collect())
    }

    #[test]
    fn names_are_unique_and_found_and_defaults_are_good() {
        for kind in kinds() {
            assert_eq!(find(kind.name).map(|row| row.kind.name), Some(kind.name));
            assert_eq!(kinds().iter().filter(|k| k.name == kind.name).count(), 1);
            for info in kind.params {
                assert_eq!(info.check(&defaults(kind)), Ok(()), "{}", kind.name);
            }
        }
        assert!(find("no_such_kind").is_none());
        assert_eq!(
            kinds().iter().map(|k| (k.dim)(&defaults(k))).collect::<Vec<_>>(),
            [Ok(1024), Ok(768), Ok(688)]
        );
    }

    #[test]
    fn a_patch_must_divide_the_side() {
        let kind = find("patch_norm").unwrap().kind;
        let mut params = defaults(&kind);
        params.0.insert("patch".to_owned(), ParamValue::Integer(7));
        assert!(
            (kind.dim)(&params)
                .unwrap_err()
                .contains("patch 7 does not divide side 32")
        );
        params.0.insert("patch".to_owned(), ParamValue::Integer(0));
        assert!((kind.dim)(&params).is_err());
    }
}
