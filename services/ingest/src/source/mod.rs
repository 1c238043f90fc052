//! Where events come from: a recording, the simulated street, or a live stream.

mod stdin;
mod street;
mod tcp;
#[cfg(feature = "usb")]
mod usb;

#[cfg(test)]
pub(crate) use street::hot_pixels as street_hot_pixels;

use crate::SourceError;
use crate::live::Camera;
use evpr_core::plan::{Plan, Sensor, Source};
use evpr_events::formats::prophesee::Encoding;
use evpr_events::{ReadOptions, Recording};

/// What the plan says about reading its recording.
fn options(source: &Source) -> ReadOptions {
    ReadOptions {
        time_unit: source.time_unit,
        encoding: source.format.as_deref().and_then(Encoding::from_name),
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
        _ if source.live.is_some() => Err(SourceError::Setup(format!(
            "{}: a live source cannot be read in advance; to mask its hot pixels, find them in a recording with `evpr events \
             hot-pixels`",
            source.path.display()
        ))),
        (kind, _) => Err(SourceError::Setup(format!(
            "source.kind \"{kind}\" is not known, or incomplete; this build replays \"file\" and \"street\""
        ))),
    }
}

/// What the plan's live source is connected to with. `again`: ingest has read from it before in this run.
///
/// # Errors
/// When this build has no such source, or it cannot be read in the middle.
pub(crate) fn camera(plan: &Plan, again: bool) -> Result<Box<dyn Camera>, SourceError> {
    let source = &plan.source;
    let options = ReadOptions {
        sensor: Some(plan.sensor),
        ..options(source)
    };
    let address = source.live.as_ref().and_then(|live| live.address.clone());
    match (source.kind.as_str(), address) {
        ("stdin", _) if again => Err(SourceError::Setup(
            "standard input: cannot be read from its middle, and a process that had read from it, or waited for what \
             was read, has died; start the run again, or use a recording or a TCP server"
                .to_owned(),
        )),
        ("stdin", _) => Ok(Box::new(stdin::Stdin::new(options))),
        ("tcp", Some(address)) => Ok(Box::new(tcp::Tcp::new(address, tcp::Speaks::AnyFormat, options))),
        ("aedat4_tcp", Some(address)) => Ok(Box::new(tcp::Tcp::new(address, tcp::Speaks::Aedat4, options))),
        #[cfg(feature = "usb")]
        ("usb", _) => {
            let serial = source.live.as_ref().and_then(|live| live.serial.clone());
            Ok(Box::new(usb::Usb::new(&source.path, serial)))
        }
        #[cfg(not(feature = "usb"))]
        ("usb", _) => Err(SourceError::Setup(
            "source.kind \"usb\": this build has no USB cameras; build it with --features usb".to_owned(),
        )),
        (kind, _) => Err(SourceError::Setup(format!(
            "source.kind \"{kind}\" is not known to this build, or incomplete"
        ))),
    }
}

/// Whether opening it again gives the same events again, from the first one on.
pub(crate) fn can_be_read_again(source: &Source) -> bool {
    matches!(source.kind.as_str(), "file" | "street")
}

/// Asks a source for the size of its sensor. `None` when it does not say: then the configuration must. A street has
/// the sensor that it was given, a source of frames has their size, and a live stream is not asked.
///
/// # Errors
/// As [`open`].
pub fn probe(source: &Source) -> Result<Option<Sensor>, SourceError> {
    match (&source.street, &source.frames) {
        // Without building it.
        (Some(street), _) => Ok(Some(street.sensor)),
        (None, Some(_)) => crate::frames::probe(source).map(Some),
        (None, None) if source.live.is_some() => Ok(None),
        (None, None) => Ok(open(source)?.sensor()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_format_that_the_configuration_knows_is_read() {
        for name in evpr_core::config::RAW_FORMATS
            .all()
            .into_iter()
            .filter(|name| *name != "auto")
        {
            assert!(Encoding::from_name(name).is_some(), "{name}");
        }
        assert_eq!(
            evpr_core::config::RAW_FORMATS.all().len(),
            Encoding::ALL.len() + 1
        );
    }

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
