//! Noise of the camera: which pixels are masked, and which events are left out besides.

use super::{Plan, Reconstruction, Source};
use crate::time::format_duration;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A pixel: column and row, from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(from = "(u16, u16)", into = "(u16, u16)")]
pub struct Pixel {
    /// Column.
    pub x: u16,
    /// Row.
    pub y: u16,
}

impl From<(u16, u16)> for Pixel {
    fn from((x, y): (u16, u16)) -> Self {
        Self { x, y }
    }
}

impl From<Pixel> for (u16, u16) {
    fn from(pixel: Pixel) -> Self {
        (pixel.x, pixel.y)
    }
}

/// When a pixel counts as hot. With n the number of its events in a stretch of T seconds, and n₃ the third largest
/// number among the 24 pixels around it (5 × 5, mirrored at the border of the sensor), it is hot when
/// `n ≥ max(min_rate_hz · T, 20)` and `n > factor · n₃`.
///
/// A hot pixel stands alone, whereas what the camera sees makes neighbours fire: even a line, the thinnest thing that
/// it sees, gives a pixel four busy ones around it. So edges that stay in place are no hot pixels, and up to three hot
/// pixels side by side are found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HotPixelRule {
    /// How many times the events of the third busiest neighbour; above 1.
    pub factor: f64,
    /// At least so many events per second.
    pub min_rate_hz: f64,
}

impl Default for HotPixelRule {
    fn default() -> Self {
        Self {
            factor: 3.0,
            min_rate_hz: 5.0,
        }
    }
}

/// Where the mask comes from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HotPixelsFrom {
    /// A text file with a line `x,y` for each.
    File(PathBuf),
    /// The first stretch of the recording.
    Learn {
        /// Its length from the first event, ns.
        period_ns: u64,
        /// What decides.
        rule: HotPixelRule,
    },
}

/// Who leaves the masked pixels out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskedBy {
    /// Ingest: nobody sees their events.
    Ingest,
    /// Those reconstructions whose kind says that it masks; the others see all events (the paper's authors' code, which
    /// masks for E2VID only).
    Reconstruction,
}

/// The mask of hot pixels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HotPixels {
    /// Where it comes from.
    pub from: HotPixelsFrom,
    /// Who applies it.
    pub masked_by: MaskedBy,
    /// The pixels, inside the sensor, by rows. `None` until they are known: ingest finds them before the processes
    /// start, so that all of them, and those that start again, have the same. A live stream cannot be looked at in
    /// advance: there they stay unknown here, and ingest learns them under way.
    pub pixels: Option<Vec<Pixel>>,
}

/// Filters of events, by what their pixel and its neighbours did before. `None`: off.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Filters {
    /// An event is left out when it comes earlier than this after the latest event of its pixel that was not left out
    /// so, ns.
    pub refractory_ns: Option<u64>,
    /// An event is left out unless one of the eight neighbours of its pixel had an event at most this long before, ns.
    /// Events that were left out by the refractory filter do not count; those left out by this one do.
    pub background_activity_ns: Option<u64>,
}

impl Plan {
    /// The pixels that reconstruction `index` has to leave out by itself: those of `source.hot_pixels`, when it is the
    /// reconstructions that mask and this one's kind does. Empty for all others.
    pub fn reconstruction_mask(&self, index: usize) -> &[Pixel] {
        let masks = self
            .reconstructions
            .get(index)
            .is_some_and(|r| r.masks_hot_pixels);
        let hot = self.source.hot_pixels.as_ref();
        hot.filter(|hot| masks && hot.masked_by == MaskedBy::Reconstruction)
            .and_then(|hot| hot.pixels.as_deref())
            .unwrap_or_default()
    }
}

impl Source {
    /// What decides whether rows of this reconstruction can be compared, as far as noise is concerned: that there is a mask
    /// and who applies it, but not its pixels, which differ a little from one recording of a camera to the next, nor
    /// how they were found; and the lengths of the filters.
    pub(super) fn noise_fingerprint(&self, r: &Reconstruction) -> Vec<(&'static str, String)> {
        let mut print = Vec::new();
        match &self.hot_pixels {
            Some(hot) if hot.masked_by == MaskedBy::Ingest => {
                print.push(("hot_pixels", "masked at ingest".to_owned()));
            }
            Some(_) if r.masks_hot_pixels => {
                print.push(("hot_pixels", "masked by the reconstruction".to_owned()));
            }
            _ => {}
        }
        let filters = &self.filters;
        for (key, length_ns) in [
            ("refractory", filters.refractory_ns),
            ("background_activity", filters.background_activity_ns),
        ] {
            print.extend(length_ns.map(|ns| (key, format_duration(ns))));
        }
        print
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::test_plan;

    fn hot(masked_by: MaskedBy, pixels: &[(u16, u16)]) -> Option<HotPixels> {
        Some(HotPixels {
            from: HotPixelsFrom::File("hot.txt".into()),
            masked_by,
            pixels: Some(pixels.iter().copied().map(Pixel::from).collect()),
        })
    }

    #[test]
    fn the_fingerprint_holds_the_policy_and_not_the_pixels() {
        let plain = test_plan();
        let mut masked = plain.clone();
        masked.source.hot_pixels = hot(MaskedBy::Ingest, &[(1, 2)]);
        assert_ne!(plain.fingerprint(0), masked.fingerprint(0));
        assert_eq!(masked.fingerprint(0)["hot_pixels"], "masked at ingest");
        let mut learned = plain.clone();
        learned.source.hot_pixels = Some(HotPixels {
            from: HotPixelsFrom::Learn {
                period_ns: 5_000_000_000,
                rule: HotPixelRule::default(),
            },
            masked_by: MaskedBy::Ingest,
            pixels: None,
        });
        assert_eq!(learned.fingerprint(1), masked.fingerprint(1));
        let mut filtered = plain.clone();
        filtered.source.filters.refractory_ns = Some(1_000_000);
        assert_eq!(filtered.fingerprint(0)["refractory"], "1ms");
        filtered.source.filters.background_activity_ns = Some(5_000_000);
        assert_eq!(filtered.fingerprint(0)["background_activity"], "5ms");
        assert_eq!(filtered.fingerprint(0).len(), plain.fingerprint(0).len() + 2);
    }

    #[test]
    fn only_a_reconstruction_that_masks_gets_the_mask() {
        let mut plan = test_plan();
        plan.reconstructions[1].masks_hot_pixels = true;
        plan.source.hot_pixels = hot(MaskedBy::Reconstruction, &[(5, 3)]);
        assert!(plan.reconstruction_mask(0).is_empty() && plan.reconstruction_mask(7).is_empty());
        assert_eq!(plan.reconstruction_mask(1), [Pixel { x: 5, y: 3 }]);
        assert_eq!(plan.fingerprint(0), test_plan().fingerprint(0));
        assert_eq!(plan.fingerprint(1)["hot_pixels"], "masked by the reconstruction");
        plan.source.hot_pixels = hot(MaskedBy::Ingest, &[(5, 3)]);
        assert!(plan.reconstruction_mask(1).is_empty());
    }
}
