//! What a binary knows how to do: the kinds of reconstructions and extractors with their parameters. The crates of
//! the stages fill these in; the configuration is checked against them.

use super::{Models, ParamValue, Params};
use crate::message::ChannelOrder;

/// What values a parameter takes, and which one it has when the configuration does not name it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ParamKind {
    /// A span of time, written as `"100ms"`, kept in [`Params`] as whole nanoseconds; above 0.
    Duration {
        /// Default, ns.
        default_ns: u64,
    },
    /// A whole number.
    Integer {
        /// Default.
        default: i64,
        /// Least value allowed.
        min: i64,
        /// Greatest value allowed.
        max: i64,
    },
    /// A finite number.
    Float {
        /// Default.
        default: f64,
        /// Least value allowed.
        min: f64,
        /// Greatest value allowed.
        max: f64,
    },
    /// One of a few words.
    Choice {
        /// Default; one of `options`.
        default: &'static str,
        /// The words.
        options: &'static [&'static str],
    },
}

/// A parameter of a kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParamInfo {
    /// Its key in the `params` table of the configuration.
    pub name: &'static str,
    /// What values it takes.
    pub kind: ParamKind,
    /// One line: what it does, with its unit.
    pub doc: &'static str,
}

impl ParamInfo {
    /// The value that it has when the configuration does not name it.
    pub fn default_value(&self) -> ParamValue {
        match self.kind {
            ParamKind::Duration { default_ns } => {
                ParamValue::Integer(i64::try_from(default_ns).unwrap_or(i64::MAX))
            }
            ParamKind::Integer { default, .. } => ParamValue::Integer(default),
            ParamKind::Float { default, .. } => ParamValue::Float(default),
            ParamKind::Choice { default, .. } => ParamValue::Text(default.to_owned()),
        }
    }

    /// Checks that `params` has this parameter, with a value of the right type and range.
    ///
    /// # Errors
    /// One line: what is wrong with it and what is allowed.
    pub fn check(&self, params: &Params) -> Result<(), String> {
        let name = self.name;
        let Some(value) = params.0.get(name) else {
            return Err(format!("parameter \"{name}\" is missing; {}", self.allowed()));
        };
        let fits = match (self.kind, value) {
            (ParamKind::Duration { .. }, ParamValue::Integer(v)) => *v > 0,
            (ParamKind::Integer { min, max, .. }, ParamValue::Integer(v)) => (min..=max).contains(v),
            (ParamKind::Float { min, max, .. }, ParamValue::Float(v)) => (min..=max).contains(v),
            (ParamKind::Float { min, max, .. }, ParamValue::Integer(v)) => (min..=max).contains(&(*v as f64)),
            (ParamKind::Choice { options, .. }, ParamValue::Text(v)) => options.contains(&v.as_str()),
            _ => false,
        };
        if fits {
            Ok(())
        } else {
            Err(format!("parameter \"{name}\" is {value}; {}", self.allowed()))
        }
    }

    /// What it may be, for an error message.
    fn allowed(&self) -> String {
        match self.kind {
            ParamKind::Duration { .. } => "give a duration above 0".to_owned(),
            ParamKind::Integer { min, max, .. } => format!("give a whole number from {min} to {max}"),
            ParamKind::Float { min, max, .. } => format!("give a number from {min} to {max}"),
            ParamKind::Choice { options, .. } => format!("give one of {}", options.join(", ")),
        }
    }
}

/// A method of reconstruction: one row of the reconstruct crate's registry.
#[derive(Debug, Clone, Copy)]
pub struct ReconstructionKind {
    /// Its name in the configuration.
    pub name: &'static str,
    /// One line: what its frames show.
    pub doc: &'static str,
    /// What the channels of its frames mean; this also gives their number.
    pub channel_order: ChannelOrder,
    /// Its parameters.
    pub params: &'static [ParamInfo],
    /// Whether it leaves hot pixels out by itself when `source.hot_pixels.apply` asks the reconstructions to: it then
    /// takes [`super::Plan::reconstruction_mask`].
    pub masks_hot_pixels: bool,
}

/// A kind of extractor: one row of the extract crate's registry.
#[derive(Debug, Clone, Copy)]
pub struct ExtractorKind {
    /// Its name in the configuration.
    pub name: &'static str,
    /// One line: what its rows are.
    pub doc: &'static str,
    /// Its parameters.
    pub params: &'static [ParamInfo],
    /// Length of its rows with these parameters (defaults filled in), or one line saying what is wrong with this
    /// combination of them.
    pub dim: fn(&Params) -> Result<usize, String>,
}

/// The parameter `state` of a network that carries its memory from tick to tick.
pub const CARRY: &str = "carry";

/// The parameters of a reconstruction that is a network.
pub const NETWORK_PARAMS: &[ParamInfo] = &[ParamInfo {
    name: "state",
    kind: ParamKind::Choice {
        default: "reset",
        options: &["reset", CARRY],
    },
    doc: "the network's memory: reset before every frame (the paper), or carried from tick to tick, window by window, \
          and reset where a tick is missing",
}];

/// Everything that a configuration is checked against.
#[derive(Debug, Clone, Copy)]
pub struct Catalog<'a> {
    /// Methods of reconstruction that the binary knows.
    pub reconstructions: &'static [ReconstructionKind],
    /// Kinds of extractors that the binary knows.
    pub extractors: &'static [ExtractorKind],
    /// Networks that the registry of models has.
    pub models: Models<'a>,
    /// Cores to share out among the networks.
    pub cores: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_have_the_form_that_params_keep() {
        let value = |kind| {
            let info = ParamInfo {
                name: "p",
                kind,
                doc: "",
            };
            info.default_value()
        };
        let duration = ParamKind::Duration {
            default_ns: 100_000_000,
        };
        assert_eq!(value(duration), ParamValue::Integer(100_000_000));
        let integer = ParamKind::Integer {
            default: 32,
            min: 1,
            max: 64,
        };
        assert_eq!(value(integer), ParamValue::Integer(32));
        let float = ParamKind::Float {
            default: 0.5,
            min: 0.0,
            max: 1.0,
        };
        assert_eq!(value(float), ParamValue::Float(0.5));
        let choice = ParamKind::Choice {
            default: "none",
            options: &["none", "log1p"],
        };
        assert_eq!(value(choice), ParamValue::Text("none".to_owned()));
    }

    #[test]
    fn values_are_checked_for_type_and_range() {
        let info = |kind| ParamInfo {
            name: "p",
            kind,
            doc: "",
        };
        let integer = info(ParamKind::Integer {
            default: 32,
            min: 1,
            max: 64,
        });
        let choice = info(ParamKind::Choice {
            default: "none",
            options: &["none", "log1p"],
        });
        let with = |value| Params([("p".to_owned(), value)].into());
        assert_eq!(integer.check(&with(integer.default_value())), Ok(()));
        assert_eq!(choice.check(&with(choice.default_value())), Ok(()));
        assert_eq!(
            integer.check(&with(ParamValue::Integer(65))),
            Err("parameter \"p\" is 65; give a whole number from 1 to 64".to_owned())
        );
        assert_eq!(
            choice.check(&with(ParamValue::Text("sqrt".to_owned()))),
            Err("parameter \"p\" is sqrt; give one of none, log1p".to_owned())
        );
        assert!(integer.check(&Params::default()).is_err());
        assert!(integer.check(&with(ParamValue::Float(3.0))).is_err());
        let duration = info(ParamKind::Duration { default_ns: 1 });
        assert!(duration.check(&with(ParamValue::Integer(0))).is_err());
        let float = info(ParamKind::Float {
            default: 0.5,
            min: 0.0,
            max: 1.0,
        });
        assert!(float.check(&with(ParamValue::Integer(1))).is_ok());
        assert!(float.check(&with(ParamValue::Float(f64::NAN))).is_err());
    }
}
