//! Standard input: the bytes of a recording or of a live stream.

use crate::SourceError;
use crate::live::Camera;
use evpr_events::{Input, ReadOptions, Recording};
use std::io::IsTerminal;

/// See the module.
pub(super) struct Stdin {
    options: ReadOptions,
}

impl Stdin {
    pub(super) fn new(options: ReadOptions) -> Self {
        Self { options }
    }
}

impl Camera for Stdin {
    fn connect(&mut self) -> Result<Box<dyn Recording>, SourceError> {
        let stdin = std::io::stdin();
        if stdin.is_terminal() {
            return Err(SourceError::Setup(
                "standard input: is a terminal; pipe a recording or a camera's stream into it".to_owned(),
            ));
        }
        evpr_events::open_input(Input::new("standard input", stdin), &self.options)
    }

    fn once(&self) -> bool {
        true
    }
}
