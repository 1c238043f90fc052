//! Progress bars, on terminals only.

use evpr_runtime::Progress;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;

/// A bar over permille of the input; nothing when stderr is not a terminal or it is unwanted.
pub(crate) fn bar(unwanted: bool, what: &str) -> ProgressBar {
    if unwanted || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style =
        ProgressStyle::with_template("{prefix} [{bar:40}] {percent:>3}% {msg} ({elapsed}, {eta} left)")
            .unwrap_or_else(|_| ProgressStyle::default_bar())
            .progress_chars("=> ");
    ProgressBar::new(1000)
        .with_style(style)
        .with_prefix(what.to_owned())
}

/// Moves the bar.
pub(crate) fn show(bar: &ProgressBar, progress: &Progress) {
    bar.set_position(progress.permille);
    let ticks = progress.answers.max(progress.recorded);
    bar.set_message(format!(
        "{ticks} ticks, {:.1} M events",
        progress.events as f64 / 1e6
    ));
}
