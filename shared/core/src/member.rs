//! Members of the ensemble, and how a member's tick can end.
#![allow(unsafe_code)] // the ZeroCopySend derive expands to unsafe impls

use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;
use serde::{Deserialize, Serialize};

/// The most members a plan may have (the paper's largest ensemble has 64).
pub const MAX_MEMBERS: usize = 256;
/// The most windows a plan may have.
pub const MAX_WINDOWS: usize = 32;
/// The most extractors a plan may have.
pub const MAX_EXTRACTORS: usize = 32;

/// A set of members, by their index in the plan.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("evpr.MemberSet.1")]
pub struct MemberSet {
    words: [u64; MAX_MEMBERS / 64],
}

impl MemberSet {
    /// Adds or removes a member. Indices of [`MAX_MEMBERS`] and above are ignored.
    pub fn set(&mut self, member: usize, enabled: bool) {
        if let Some(word) = self.words.get_mut(member / 64) {
            let bit = 1u64 << (member % 64);
            *word = if enabled { *word | bit } else { *word & !bit };
        }
    }

    /// True when the member is in the set.
    pub fn contains(&self, member: usize) -> bool {
        self.words
            .get(member / 64)
            .is_some_and(|w| w >> (member % 64) & 1 == 1)
    }

    /// True when no member is in the set.
    pub fn is_empty(&self) -> bool {
        self.words.iter().all(|w| *w == 0)
    }

    /// How many members are in the set.
    pub fn len(&self) -> usize {
        self.words.iter().map(|w| w.count_ones() as usize).sum()
    }

    /// The members in the set, ascending.
    pub fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        (0..MAX_MEMBERS).filter(|m| self.contains(*m))
    }
}

impl FromIterator<usize> for MemberSet {
    fn from_iter<I: IntoIterator<Item = usize>>(members: I) -> Self {
        let mut set = Self::default();
        for m in members {
            set.set(m, true);
        }
        set
    }
}

/// Why a member has no row at a tick, or a tick no answer. The code travels in headers; 0 and 1 are taken there.
#[repr(u8)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// The window had no events.
    EmptyWindow = 2,
    /// The window lost a chunk, or was under way when its process joined.
    IncompleteWindow = 3,
    /// The window would reach before the start of the recording.
    BeforeStart = 4,
    /// A stage fell behind and dropped the whole tick.
    Dropped = 5,
    /// The row had not come by the deadline.
    Late = 6,
    /// The reconstruction's process was dead (tombstone).
    ReconstructDown = 7,
    /// The extractor's process was dead (tombstone).
    ExtractDown = 8,
    /// The stage could not use its input (it says why in its log).
    Failed = 9,
    /// Answer: not enough rows yet for the sequence method to tell places apart.
    NoHistory = 10,
    /// Answer: no enabled member had a row.
    NoRows = 11,
    /// Answer: all members are switched off.
    NoMembers = 12,
    /// The tick was lost before it reached the fuser (its process or ingest was away).
    Lost = 13,
    /// The camera was away, or started anew.
    Disconnected = 14,
    /// Answer: its confidence is below the least that was asked for.
    LowConfidence = 15,
}

impl Reason {
    /// All reasons.
    pub const ALL: [Reason; 14] = [
        Reason::EmptyWindow,
        Reason::IncompleteWindow,
        Reason::BeforeStart,
        Reason::Dropped,
        Reason::Late,
        Reason::ReconstructDown,
        Reason::ExtractDown,
        Reason::Failed,
        Reason::NoHistory,
        Reason::NoRows,
        Reason::NoMembers,
        Reason::Lost,
        Reason::Disconnected,
        Reason::LowConfidence,
    ];

    /// The reason with this code.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|r| r.code() == code)
    }

    /// The number that travels in headers.
    pub fn code(self) -> u32 {
        self as u32
    }

    /// For a person.
    pub fn text(self) -> &'static str {
        match self {
            Reason::EmptyWindow => "empty window",
            Reason::IncompleteWindow => "incomplete window",
            Reason::BeforeStart => "before the start of the recording",
            Reason::Dropped => "dropped: a stage fell behind",
            Reason::Late => "late: not there by the deadline",
            Reason::ReconstructDown => "reconstruction down",
            Reason::ExtractDown => "extractor down",
            Reason::Failed => "the stage could not use its input",
            Reason::NoHistory => "no history",
            Reason::NoRows => "no member had a row",
            Reason::NoMembers => "all members are disabled",
            Reason::Lost => "lost on the way",
            Reason::Disconnected => "the camera was disconnected",
            Reason::LowConfidence => "low confidence",
        }
    }
}

/// How a member's tick ended. A tombstone is a [`End::None`] with [`Reason::ReconstructDown`] or
/// [`Reason::ExtractDown`].
#[derive(Debug, Clone, PartialEq)]
pub enum End<T> {
    /// With a row.
    Row(T),
    /// Without one.
    None(Reason),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_and_codes() {
        let mut s: MemberSet = [0, 63, 64, 255].into_iter().collect();
        assert_eq!(s.iter().collect::<Vec<_>>(), [0, 63, 64, 255]);
        s.set(63, false);
        s.set(256, true);
        assert!(!s.contains(63) && !s.contains(256) && s.contains(64));
        assert_eq!(s.len(), 3);
        for r in Reason::ALL {
            assert_eq!(Reason::from_code(r.code()), Some(r));
            assert!(r.code() > 1);
        }
        assert_eq!(Reason::from_code(0), None);
    }
}
