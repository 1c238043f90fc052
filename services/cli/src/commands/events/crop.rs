//! A part of the sensor: a rectangle to keep.

use crate::failure::Failure;
use evpr_core::plan::Sensor;
use evpr_events::RawEvent;

/// A rectangle of the sensor; its corner becomes (0, 0).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Crop {
    x: u16,
    y: u16,
    pub(super) width: u16,
    pub(super) height: u16,
}

impl std::str::FromStr for Crop {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Result<Vec<u16>, _> = text.split(',').map(|n| n.trim().parse()).collect();
        match numbers.as_deref() {
            Ok(&[x, y, width, height]) if width > 0 && height > 0 => Ok(Self { x, y, width, height }),
            _ => Err("not a rectangle; write column,row,width,height, such as 10,20,128,96".to_owned()),
        }
    }
}

impl Crop {
    /// Refuses what reaches out of the sensor.
    pub(super) fn check(self, sensor: Sensor) -> Result<(), Failure> {
        let right = usize::from(self.x) + usize::from(self.width);
        let bottom = usize::from(self.y) + usize::from(self.height);
        if right > sensor.width || bottom > sensor.height {
            return Err(Failure::usage(format!(
                "--crop reaches to column {right} and row {bottom}, beyond the sensor of {sensor}"
            )));
        }
        Ok(())
    }

    /// The event as the rectangle has it; `None` outside.
    pub(super) fn apply(self, event: &RawEvent) -> Option<RawEvent> {
        let (x, y) = (event.x.checked_sub(self.x)?, event.y.checked_sub(self.y)?);
        (x < self.width && y < self.height).then_some(RawEvent { x, y, ..*event })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rectangle_keeps_what_is_in_it() {
        let crop: Crop = "10,20,2,3".parse().unwrap();
        let event = |x, y| RawEvent {
            x,
            y,
            t_ns: 7,
            on: true,
        };
        assert_eq!(crop.apply(&event(10, 20)), Some(event(0, 0)));
        assert_eq!(crop.apply(&event(11, 22)), Some(event(1, 2)));
        for (x, y) in [(9, 20), (10, 19), (12, 20), (10, 23)] {
            assert_eq!(crop.apply(&event(x, y)), None);
        }
        for bad in ["", "1,2,3", "1,2,0,3", "1,2,3,4,5", "-1,2,3,4", "a,b,c,d"] {
            assert!(bad.parse::<Crop>().is_err(), "{bad}");
        }
        let sensor = |height, width| Sensor { height, width };
        assert!(crop.check(sensor(23, 12)).is_ok());
        assert!(crop.check(sensor(22, 12)).is_err() && crop.check(sensor(23, 11)).is_err());
    }
}
