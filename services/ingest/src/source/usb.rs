//! USB cameras: Prophesee EVK3 HD and EVK4, iniVation DVXplorer and DAVIS346.

use crate::SourceError;
use crate::live::Camera;
use evpr_core::plan::Sensor;
use evpr_events::{BATCH_EVENTS, RawEvent, Recording, SourceInfo};
use neuromorphic_drivers as drivers;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// How long to wait for data before asking whether the camera is still there: it does not say so by itself.
const WAIT: Duration = Duration::from_millis(100);

type Flag = drivers::Flag<drivers::Error, drivers::UsbOverflow>;

/// See the module.
pub(super) struct Usb {
    name: PathBuf,
    serial: Option<String>,
}

impl Usb {
    /// The camera of this serial number, or the first that is found; `name` is what it is called in messages.
    pub(super) fn new(name: &Path, serial: Option<String>) -> Self {
        Self {
            name: name.to_owned(),
            serial,
        }
    }

    fn failed(&self, e: &dyn std::fmt::Display) -> SourceError {
        let name = self.name.display();
        let what = e.to_string();
        // The words of libusb.
        let advice = if what.contains("Access denied") {
            "copy config/udev/99-evpr-event-cameras.rules to /etc/udev/rules.d, and plug the camera in again \
             (docs/usb-cameras.md)"
        } else {
            "check the cable, and that no other program uses the camera"
        };
        SourceError::Setup(format!("{name}: {what}; {advice}"))
    }
}

impl Camera for Usb {
    fn connect(&mut self) -> Result<Box<dyn Recording>, SourceError> {
        use drivers::Configuration as C;
        let (flag, event_loop) = drivers::flag_and_event_loop().map_err(|e| self.failed(&e))?;
        let identifier = match &self.serial {
            Some(serial) => drivers::Identifier::Serial(serial),
            None => drivers::Identifier::None,
        };
        let kinds = [
            C::PropheseeEvk4(drivers::prophesee_evk4::DEFAULT_CONFIGURATION),
            C::PropheseeEvk3Hd(drivers::prophesee_evk3_hd::DEFAULT_CONFIGURATION),
            C::InivationDvxplorer(drivers::inivation_dvxplorer::DEFAULT_CONFIGURATION),
            C::InivationDavis346(drivers::inivation_davis346::DEFAULT_CONFIGURATION),
        ];
        for kind in kinds {
            let opened = drivers::open(identifier, Some(kind), None, event_loop.clone(), flag.clone());
            match opened.map_err(drivers::Error::unpack) {
                Ok(device) => {
                    return Ok(Box::new(Stream::new(
                        self.name.clone(),
                        device,
                        flag,
                        event_loop,
                    )?));
                }
                Err(drivers::Error::Device(_) | drivers::Error::DeviceWithSerial { .. }) => {}
                Err(e) => return Err(self.failed(&e)),
            }
        }
        Err(SourceError::Setup(format!(
            "{}: no camera found; plug in a Prophesee EVK3 HD or EVK4, or an iniVation DVXplorer or DAVIS346{}",
            self.name.display(),
            if self.serial.is_some() {
                " of the serial number source.serial"
            } else {
                ""
            }
        )))
    }
}

/// An open camera.
struct Stream {
    name: PathBuf,
    device: drivers::Device,
    adapter: drivers::Adapter,
    sensor: Sensor,
    flag: Flag,
    /// Decoded, and how many of them have been handed out.
    decoded: Vec<RawEvent>,
    handed_out: usize,
    overflows: u64,
    _event_loop: Arc<drivers::UsbEventLoop>,
}

impl Stream {
    fn new(
        name: PathBuf,
        device: drivers::Device,
        flag: Flag,
        event_loop: Arc<drivers::UsbEventLoop>,
    ) -> Result<Self, SourceError> {
        use drivers::Properties as P;
        let (width, height) = match device.properties() {
            P::PropheseeEvk4(p) => (p.width, p.height),
            P::PropheseeEvk3Hd(p) => (p.width, p.height),
            P::InivationDvxplorer(p) => (p.width, p.height),
            P::InivationDavis346(p) => (p.width, p.height),
            _ => {
                return Err(SourceError::Setup(format!(
                    "{}: {} is not a camera that this build reads",
                    name.display(),
                    device.name()
                )));
            }
        };
        Ok(Self {
            name,
            adapter: device.create_adapter(),
            device,
            sensor: Sensor {
                height: usize::from(height),
                width: usize::from(width),
            },
            flag,
            decoded: Vec::new(),
            handed_out: 0,
            overflows: 0,
            _event_loop: event_loop,
        })
    }

    /// Reads what has come, if anything has, into `decoded`.
    fn read(&mut self) -> Result<(), SourceError> {
        self.decoded.clear();
        self.handed_out = 0;
        if let Some(view) = self.device.next_with_timeout(&WAIT) {
            let decoded = &mut self.decoded;
            let push = |e: drivers::types::PolarityEvent<u64, u16, u16>| {
                decoded.push(RawEvent {
                    t_ns: e.t.saturating_mul(1_000),
                    x: e.x,
                    y: e.y,
                    on: e.polarity == drivers::types::Polarity::On,
                });
            };
            match &mut self.adapter {
                drivers::Adapter::Evt3(adapter) => adapter.convert(view.slice, push, |_| {}),
                drivers::Adapter::Dvxplorer(adapter) => adapter.convert(view.slice, push, |_| {}, |_| {}),
                drivers::Adapter::Davis346(adapter) => {
                    adapter.convert(view.slice, push, |_| {}, |_| {}, |_| {});
                }
            }
        }
        if self.flag.load_warning().is_some() {
            self.overflows += 1;
        }
        self.flag
            .load_error()
            .map_err(|e| SourceError::Setup(format!("{}: {e}", self.name.display())))
    }
}

impl Recording for Stream {
    fn sensor(&self) -> Option<Sensor> {
        Some(self.sensor)
    }

    fn next_batch(&mut self, out: &mut Vec<RawEvent>) -> Result<bool, SourceError> {
        out.clear();
        if self.handed_out >= self.decoded.len() {
            self.read()?;
        }
        let left = self.decoded.get(self.handed_out..).unwrap_or_default();
        let n = left.len().min(BATCH_EVENTS);
        out.extend_from_slice(&left[..n]);
        self.handed_out += n;
        Ok(true)
    }

    fn progress_permille(&self) -> u64 {
        0
    }

    fn describe(&self) -> SourceInfo {
        SourceInfo {
            format: self.device.name(),
            path: self.name.clone(),
            time_unit: "us",
            time_unit_from: "format",
            events: None,
        }
    }

    fn take_overflows(&mut self) -> u64 {
        std::mem::take(&mut self.overflows)
    }
}
