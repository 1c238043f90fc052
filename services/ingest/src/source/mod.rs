//! Where events come from: a recording, or the simulated street.

mod street;

#[cfg(test)]
pub(crate) use street::hot_pixels as street_hot_pixels;

use crate::SourceError;
use evpr_core::plan::{Sensor, Source};
use evpr_events::{ReadOptions, Recording};

/// What the plan says about reading its recording.
fn options(source: &Source) -> ReadOptions {
    ReadOptions {
        time_unit: source.time_unit,
        ..ReadOptions::default()
    }
}

/// Opens the plan's source.
///
/// # Errors
/// One line, when it does not exist, cannot be read, is empty or of no known format, or holds no events.
pub fn open(source: &Source) -> Result<Box<dyn Recording>, SourceError> {
    match (source.kind.as_str(), &source.street) {
        ("file", _) => evpr_events::open(&source.path, &options(source)),
        ("street", Some(street)) => Ok(Box::new(street::Street::new(street, &source.path))),
        (kind, _) => Err(SourceError::Setup(format!(
            "source.kind \"{kind}\" is not known, or incomplete; this build reads \"file\" and \"street\""
        ))),
    }
}

/// Whether opening it again gives the same events again, from the first one on.
pub(crate) fn can_be_read_again(source: &Source) -> bool {
    matches!(source.kind.as_str(), "file" | "street")
}

/// Asks a source for the size of its sensor. `None` when it does not say: then the configuration must. A street has
/// the sensor that it was given; a source of frames has their size.
///
/// # Errors
/// As [`open`].
pub fn probe(source: &Source) -> Result<Option<Sensor>, SourceError> {
    match (&source.street, &source.frames) {
        // Without building it.
        (Some(street), _) => Ok(Some(street.sensor)),
        (None, Some(_)) => crate::frames::probe(source).map(Some),
        (None, None) => Ok(open(source)?.sensor()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_kind_is_refused() {
        let usb = Source {
            kind: "usb".to_owned(),
            ..Source::file("x")
        };
        let error = open(&usb).err().unwrap().to_string();
        assert!(error.contains("\"usb\" is not known"), "{error}");
    }
}
