//! A TCP server that sends the bytes of a stream of events to whoever connects.

use crate::SourceError;
use crate::live::Camera;
use evpr_events::{Input, ReadOptions, Recording};
use nix::sys::socket::{setsockopt, sockopt};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

/// Longest wait for one address to answer.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// A peer that has not sent anything for so long, s, is asked whether it is there.
const KEEP_ALIVE_IDLE_S: u32 = 5;
/// So many times, this long apart, s.
const KEEP_ALIVE_PROBES: u32 = 3;
const KEEP_ALIVE_INTERVAL_S: u32 = 2;

/// What the bytes are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Speaks {
    /// Any format that can be read in order, as its content says.
    AnyFormat,
    /// AEDAT4 without its first line, as DV software serves it.
    Aedat4,
}

/// See the module.
pub(super) struct Tcp {
    address: String,
    speaks: Speaks,
    options: ReadOptions,
}

impl Tcp {
    /// `address` is `host:port`.
    pub(super) fn new(address: String, speaks: Speaks, options: ReadOptions) -> Self {
        Self {
            address,
            speaks,
            options,
        }
    }

    fn dial(&self) -> std::io::Result<TcpStream> {
        let mut refused = None;
        for address in self.address.to_socket_addrs()? {
            match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
                Ok(stream) => {
                    keep_alive(&stream)?;
                    return Ok(stream);
                }
                Err(e) => refused = Some(e),
            }
        }
        Err(refused.unwrap_or_else(|| std::io::Error::other("the name has no address")))
    }
}

/// So that a peer that vanished without a word is noticed.
fn keep_alive(stream: &TcpStream) -> nix::Result<()> {
    setsockopt(stream, sockopt::KeepAlive, &true)?;
    setsockopt(stream, sockopt::TcpKeepIdle, &KEEP_ALIVE_IDLE_S)?;
    setsockopt(stream, sockopt::TcpKeepInterval, &KEEP_ALIVE_INTERVAL_S)?;
    setsockopt(stream, sockopt::TcpKeepCount, &KEEP_ALIVE_PROBES)
}

impl Camera for Tcp {
    fn connect(&mut self) -> Result<Box<dyn Recording>, SourceError> {
        let stream = self.dial().map_err(|e| {
            SourceError::Setup(format!(
                "{}: cannot connect ({e}); check source.address, and that the server runs",
                self.address
            ))
        })?;
        let input = Input::new(&self.address, stream);
        match self.speaks {
            Speaks::AnyFormat => evpr_events::open_input(input, &self.options),
            Speaks::Aedat4 => evpr_events::formats::aedat4_network(input, &self.options),
        }
    }
}
