//! `lifecycle`: the supervisor tells the sinks who is dead, so that nobody waits for them.
#![allow(unsafe_code)] // the ZeroCopySend derive expands to unsafe impls

use super::{Message, Refusal, Stamp, check, header};
use crate::plan::Plan;
use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

/// Whether a service is there. Stored as its number.
#[repr(u32)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum ServiceHealth {
    /// Started or about to be.
    #[default]
    Up = 0,
    /// Dead, and being restarted.
    Restarting = 1,
    /// Dead, and given up.
    Down = 2,
}

/// State of one service of the plan.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("evpr.ServiceState.1")]
pub struct ServiceState {
    /// The incarnation that runs now or ran last.
    pub incarnation: u32,
    /// Every incarnation up to this one is dead: the tombstone. It is lifted for a member by the first message
    /// that a later incarnation sends for it.
    pub dead_through: u32,
    /// Number of a [`ServiceHealth`].
    pub health: u32,
    /// Unused.
    pub _pad: u32,
}

/// Header of a lifecycle message: the whole state, newest version wins.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("evpr.LifecycleHeader.1")]
pub struct LifecycleHeader {
    /// Sender and sequence.
    pub stamp: Stamp,
    /// Grows by one with each change.
    pub version: u64,
}

header!(LifecycleHeader);

/// Lifecycle messages; the payload is one state per service of the plan.
#[derive(Debug)]
pub struct Lifecycle;

impl Message for Lifecycle {
    type Header = LifecycleHeader;
    type Item = ServiceState;

    fn check(plan: &Plan, header: &LifecycleHeader, payload: &[ServiceState]) -> Result<(), Refusal> {
        check::lifecycle(plan, header, payload)
    }
}
