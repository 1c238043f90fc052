//! Answers as CSV: one line per tick, empty where there is nothing to say.

use super::{MatchLine, Sink};
use std::io::{self, Write};

const HEAD: &str = "tick,start_us,end_us,reference,score,confidence,east_m,north_m,reason,members,missing,reconstruct_us,\
                    extract_us,fuse_us,total_us\n";

/// Writes the names of the columns.
pub(super) fn begin(mut out: Box<dyn Write>) -> io::Result<Sink> {
    out.write_all(HEAD.as_bytes())?;
    Ok(Sink::Csv(out))
}

fn or_empty<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(String::new, |v| v.to_string())
}

/// Writes one line. `members` and `missing` are counts.
pub(super) fn write(line: &MatchLine<'_>, out: &mut dyn Write) -> io::Result<()> {
    let latency = &line.latency_us;
    let cells = [
        line.tick.to_string(),
        line.start_us.to_string(),
        line.end_us.to_string(),
        or_empty(line.reference),
        or_empty(line.score),
        or_empty(line.confidence),
        or_empty(line.position.map(|[east, _]| east)),
        or_empty(line.position.map(|[_, north]| north)),
        or_empty(line.reason),
        line.members.len().to_string(),
        line.missing.len().to_string(),
        or_empty(latency.reconstruct),
        or_empty(latency.extract),
        or_empty(latency.fuse),
        or_empty(latency.total),
    ];
    out.write_all((cells.join(",") + "\n").as_bytes())?;
    out.flush()
}

#[cfg(test)]
mod tests {
    use evpr_core::Reason;

    #[test]
    fn no_reason_needs_quotes() {
        for reason in Reason::ALL {
            assert!(!reason.text().contains([',', '"', '\n']), "{}", reason.text());
        }
    }
}
