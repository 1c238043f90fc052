//! The page of an evaluation: one file that asks nobody for anything, charts included.

use crate::error::EvaluateError;
use crate::measure::{FRAMES, TOLERANCES_M};
use crate::results::{Results, Row, replace};
use crate::statistics::Comparison;
use std::collections::BTreeSet;
use std::fmt::Write;

/// The page, with `{{name}}` where something goes.
const TEMPLATE: &str = include_str!("report.html");
/// Colours that the colour-blind can tell apart (Okabe and Ito).
const COLORS: [&str; 7] = [
    "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#999999",
];
const WIDTH: f64 = 800.0;
const HEIGHT: f64 = 360.0;
/// Room for the axes' numbers and names.
const MARGIN: f64 = 52.0;
/// Most lines in a chart.
const MAX_LINES: usize = 7;

impl Results {
    /// Writes `report.html`.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write_report(&self, comparisons: &[Comparison]) -> Result<(), EvaluateError> {
        replace(
            &self.folder().join("report.html"),
            &page(self.rows(), comparisons),
        )
    }
}

fn page(rows: &[Row], comparisons: &[Comparison]) -> String {
    let best = best_of_kinds(rows);
    let shown: Vec<&Row> = best.iter().copied().take(MAX_LINES).collect();
    let pairs: BTreeSet<&str> = rows.iter().map(|r| r.pair.as_str()).collect();
    let values = [
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("rows", rows.len().to_string()),
        ("pairs", pairs.len().to_string()),
        ("recall_chart", recall_chart(&best)),
        ("recall_table", recall_table(&best)),
        ("curve_chart", curve_chart(&shown)),
        ("calibration_chart", calibration_chart(&shown)),
        ("tolerance_chart", tolerance_chart(&shown)),
        ("comparisons", comparison_table(comparisons)),
    ];
    values.iter().fold(TEMPLATE.to_owned(), |page, (name, value)| {
        page.replace(&format!("{{{{{name}}}}}"), value)
    })
}

/// The best row of each pair and kind.
fn best_of_kinds(rows: &[Row]) -> Vec<&Row> {
    let mut best: Vec<&Row> = Vec::new();
    for row in rows {
        match best
            .iter_mut()
            .find(|b| (&b.pair, b.kind) == (&row.pair, row.kind))
        {
            Some(b) if row.measures.right > b.measures.right => *b = row,
            Some(_) => {}
            None => best.push(row),
        }
    }
    best.sort_by(|a, b| (&a.pair, a.kind).cmp(&(&b.pair, b.kind)));
    best
}

/// Text that may stand in HTML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

fn title(row: &Row) -> String {
    let name = format!(
        "{} {} {}, {} L={}",
        row.pair,
        row.kind.name(),
        row.subset,
        row.method,
        row.length
    );
    escaped(&format!(
        "{name}, {}, {}, {}",
        row.rule, row.similarity, row.weights
    ))
}

/// A chart from 0 to 1 upwards, and from `from` to `to` along.
struct Chart {
    from: f64,
    to: f64,
    inside: String,
    legend: String,
}

impl Chart {
    fn new(from: f64, to: f64, along: &str, up: &str) -> Self {
        let mut chart = Self {
            from,
            to,
            inside: String::new(),
            legend: String::new(),
        };
        for step in 0..=5 {
            let share = f64::from(step) / 5.0;
            let (x, y) = (chart.x(from + share * (to - from)), chart.y(share));
            let (right, floor) = (WIDTH - 10.0, HEIGHT - MARGIN);
            // Writing into a string cannot fail.
            let _ = write!(
                chart.inside,
                "<line class=\"axis\" x1=\"{MARGIN}\" x2=\"{right}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/>\
                 <text x=\"{0}\" y=\"{1:.1}\" text-anchor=\"end\">{share:.1}</text>",
                MARGIN - 6.0,
                y + 4.0
            );
            if to > from {
                let value = from + share * (to - from);
                let _ = write!(
                    chart.inside,
                    "<text x=\"{x:.1}\" y=\"{0}\" text-anchor=\"middle\">{value:.1}</text>",
                    floor + 18.0
                );
            }
        }
        let _ = write!(
            chart.inside,
            "<text x=\"{0}\" y=\"{1}\" text-anchor=\"middle\">{along}</text><text x=\"8\" y=\"16\">{up}</text>",
            (WIDTH + MARGIN) / 2.0,
            HEIGHT - 8.0
        );
        chart
    }

    fn x(&self, value: f64) -> f64 {
        MARGIN + (value - self.from) / (self.to - self.from).max(1e-12) * (WIDTH - MARGIN - 10.0)
    }

    fn y(&self, value: f64) -> f64 {
        HEIGHT - MARGIN - value.clamp(0.0, 1.0) * (HEIGHT - MARGIN - 24.0)
    }

    fn line(&mut self, at: usize, points: &[(f64, f64)], name: &str) {
        let color = COLORS[at % COLORS.len()];
        let points: Vec<String> = points
            .iter()
            .map(|(x, y)| format!("{:.1},{:.1}", self.x(*x), self.y(*y)))
            .collect();
        let _ = write!(
            self.inside,
            "<polyline fill=\"none\" stroke=\"{color}\" stroke-width=\"2\" points=\"{}\"><title>{name}</title></polyline>",
            points.join(" ")
        );
        let _ = write!(self.legend, "<br><span style=\"color:{color}\">■</span> {name}");
    }

    fn done(self, label: &str) -> String {
        format!(
            "<figure><svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{label}\">{}</svg>\n<figcaption>{label}{}\
             </figcaption></figure>\n",
            self.inside, self.legend
        )
    }
}

fn recall_chart(best: &[&Row]) -> String {
    let count = best.len().max(1) as f64;
    let mut chart = Chart::new(0.0, 0.0, "", "Recall@1 of all queries");
    let step = (WIDTH - MARGIN - 10.0) / count;
    for (at, row) in best.iter().enumerate() {
        let (m, x) = (&row.measures, MARGIN + step * (at as f64 + 0.5));
        let (top, floor) = (chart.y(m.recall_at[0].of_all), chart.y(0.0));
        let (low, high) = (
            chart.y(m.interval_95.of_all_low),
            chart.y(m.interval_95.of_all_high),
        );
        let color = COLORS[row.kind as usize % COLORS.len()];
        let width = (step * 0.7).min(60.0);
        let _ = write!(
            chart.inside,
            "<rect x=\"{:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" height=\"{:.1}\" fill=\"{color}\"><title>{} {:.4}</title></rect>\
             <line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{low:.1}\" y2=\"{high:.1}\" stroke=\"var(--ink)\" stroke-width=\"2\"/>",
            x - width / 2.0,
            floor - top,
            title(row),
            m.recall_at[0].of_all
        );
    }
    let kinds: BTreeSet<_> = best.iter().map(|r| r.kind).collect();
    for kind in kinds {
        let color = COLORS[kind as usize % COLORS.len()];
        let _ = write!(
            chart.legend,
            " <span style=\"color:{color}\">■</span> {}",
            kind.name()
        );
    }
    chart.done(
        "The best of each kind on each pair, pairs from left to right as in the table, with 95 % intervals.",
    )
}

fn recall_table(best: &[&Row]) -> String {
    let mut body = String::new();
    for row in best {
        let m = &row.measures;
        let seconds = m
            .first_right_s
            .map_or_else(|| "never".to_owned(), |s| format!("{s:.1} s"));
        let error = m
            .error_median_m
            .map_or_else(|| "-".to_owned(), |e| format!("{e:.1} m"));
        let _ = writeln!(
            body,
            "<tr><td>{}</td><td>{:.4}</td><td>{:.3}–{:.3}</td><td>{:.4}</td><td>{:.3}</td><td>{:.3}</td><td>{:.3}</td>\
             <td>{:.4}–{:.4}</td><td>{:.3}</td><td>{:.3}</td><td>{error}</td><td>{seconds}</td></tr>",
            title(row),
            m.recall_at[0].of_all,
            m.interval_95.of_all_low,
            m.interval_95.of_all_high,
            m.recall_at[0].of_matchable,
            m.recall_at[1].of_all,
            m.recall_at[2].of_all,
            m.recall_at[3].of_all,
            m.pessimistic_at_1.of_all,
            m.optimistic_at_1.of_all,
            m.precision_recall_area,
            m.recall_at_full_precision
        );
    }
    format!(
        "<div class=\"scroll\"><table><thead><tr><th>configuration</th><th>R@1 of all</th><th>95 %</th><th>of matchable</th>\
         <th>R@5</th><th>R@10</th><th>R@20</th><th>ties</th><th>PR area</th><th>R at 100 % P</th><th>median error</th>\
         <th>first right</th></tr></thead>\n<tbody>{body}</tbody></table></div>\n"
    )
}

fn curve_chart(rows: &[&Row]) -> String {
    let mut chart = Chart::new(
        0.0,
        1.0,
        "recall of the queries that have a right place",
        "precision",
    );
    for (at, row) in rows.iter().enumerate() {
        let points: Vec<(f64, f64)> = row
            .measures
            .precision_recall
            .iter()
            .map(|p| (p.recall, p.precision))
            .collect();
        chart.line(at, &points, &title(row));
    }
    chart.done("Answers of falling confidence, from left to right.")
}

fn calibration_chart(rows: &[&Row]) -> String {
    let mut chart = Chart::new(0.0, 1.0, "confidence", "share of right answers");
    for (at, row) in rows.iter().enumerate() {
        let table = row.calibration();
        let points: Vec<(f64, f64)> = table
            .iter()
            .filter(|b| b.answers > 0)
            .map(|b| {
                (
                    f64::from(b.from) / 1000.0 + 0.05,
                    f64::from(b.right) / f64::from(b.answers),
                )
            })
            .collect();
        chart.line(at, &points, &title(row));
    }
    chart.done("Per tenth of confidence the share of answers that are right. Confidence is a margin, not a probability.")
}

fn tolerance_chart(rows: &[&Row]) -> String {
    let in_metres = rows.iter().any(|r| !r.measures.by_tolerance_m.is_empty());
    let along = if in_metres {
        "tolerance, m"
    } else {
        "ticks of the map beside a right place"
    };
    let (from, to) = if in_metres { (5.0, 70.0) } else { (0.0, 20.0) };
    let mut chart = Chart::new(from, to, along, "Recall@1 of all queries");
    for (at, row) in rows.iter().enumerate() {
        let m = &row.measures;
        let points: Vec<(f64, f64)> = if in_metres {
            TOLERANCES_M
                .iter()
                .zip(&m.by_tolerance_m)
                .map(|(t, s)| (*t, s.of_all))
                .collect()
        } else {
            FRAMES
                .iter()
                .zip(&m.by_frames)
                .map(|(f, s)| (*f as f64, s.of_all))
                .collect()
        };
        chart.line(at, &points, &title(row));
    }
    chart.done("How recall grows with what counts as right.")
}

fn comparison_table(comparisons: &[Comparison]) -> String {
    let p = |p: Option<f64>| p.map_or_else(|| "-".to_owned(), |p| format!("{p:.4}"));
    let mut body = String::new();
    for c in comparisons {
        let _ = writeln!(
            body,
            "<tr><td>{}: {} − {}</td><td>{}</td><td>{:.4}</td><td>{:.4}</td><td>{:+.4}</td><td>{}</td><td>{}</td><td>{}</td>\
             <td>{}</td></tr>",
            c.what,
            escaped(&c.a),
            escaped(&c.b),
            c.pairs,
            c.mean_a,
            c.mean_b,
            c.mean_a - c.mean_b,
            p(c.wilcoxon_p),
            p(c.paired_t_p),
            p(c.welch_p),
            p(c.welch_of_all_p)
        );
    }
    format!(
        "<div class=\"scroll\"><table><thead><tr><th>a − b</th><th>pairs</th><th>mean a</th><th>mean b</th><th>difference</th>\
         <th>Wilcoxon p</th><th>paired t p</th><th>Welch p</th><th>Welch p, all recalls</th></tr></thead>\n<tbody>{body}</tbody>\
         </table></div>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_asks_nobody_for_anything_and_has_no_gaps() {
        let page = page(&[], &[]);
        for outside in ["http:", "https:", "//", "<script", "@import", "url(", "{{", "NaN"] {
            assert!(!page.contains(outside), "{outside}");
        }
    }

    #[test]
    fn text_cannot_become_markup() {
        assert_eq!(escaped("<b>&\""), "&lt;b&gt;&amp;&quot;");
    }
}
