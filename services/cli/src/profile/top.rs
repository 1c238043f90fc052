//! The live view of a running instance: the graph as a table, members to switch, the latency of late.

use crate::commands::{count_text, doing_text, time_text};
use evpr_runtime::{ServiceStatus, Status};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style, Stylize};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Cell, Row, Sparkline, Table, TableState};
use std::collections::VecDeque;

/// Latencies kept for the sparkline: more than any terminal is wide.
const KEPT: usize = 512;

/// What is shown.
#[derive(Debug, Default)]
pub(crate) struct View {
    /// The newest state, kept when the instance ends.
    pub(crate) status: Option<Status>,
    /// Why there is no newer one.
    pub(crate) gone: Option<String>,
    /// What came of the last key.
    pub(crate) message: String,
    chosen: usize,
    /// Latency of the newest answer at each look, µs.
    latencies: VecDeque<u64>,
    answers: u64,
}

impl View {
    /// Takes a new state.
    pub(crate) fn take(&mut self, status: Status) {
        if status.answers != self.answers {
            self.answers = status.answers;
            if self.latencies.len() == KEPT {
                self.latencies.pop_front();
            }
            self.latencies
                .push_back((status.latency.newest_ms * 1e3).max(0.0) as u64);
        }
        self.chosen = self.chosen.min(status.members.len().saturating_sub(1));
        self.status = Some(status);
        self.gone = None;
    }

    /// Goes up or down among the members.
    pub(crate) fn go(&mut self, by: isize) {
        let members = self.status.as_ref().map_or(0, |s| s.members.len());
        self.chosen = self
            .chosen
            .saturating_add_signed(by)
            .min(members.saturating_sub(1));
    }

    /// Goes to member `index`, if there is one.
    pub(crate) fn go_to(&mut self, index: usize) -> bool {
        let there = self.status.as_ref().is_some_and(|s| index < s.members.len());
        if there {
            self.chosen = index;
        }
        there
    }

    /// The chosen member, and what it shall be when it is switched; none without an instance.
    pub(crate) fn switch(&self) -> Option<(String, bool)> {
        let status = self.status.as_ref().filter(|_| self.gone.is_none())?;
        let member = status.members.get(self.chosen)?;
        Some((member.state.name.clone(), !member.state.enabled))
    }

    /// Draws it all.
    pub(crate) fn draw(&self, frame: &mut Frame<'_>) {
        let Some(status) = &self.status else {
            let text = self.gone.as_deref().unwrap_or("looking for the instance");
            frame.render_widget(Line::from(text), frame.area());
            return;
        };
        let processes = status.services.len() as u16 + 1;
        let members = status.members.len() as u16 + 1;
        let area = frame.area();
        // Members get what they need, and at least a few lines; processes the rest.
        let fixed = 6;
        let room = area.height.saturating_sub(fixed);
        let processes = processes.min(room.saturating_sub(members.min(4)));
        let [head, table, latency, spark, list, foot] = Layout::vertical([
            Constraint::Length(1),
            Constraint::Length(processes),
            Constraint::Length(1),
            Constraint::Length(3),
            Constraint::Min(0),
            Constraint::Length(1),
        ])
        .areas(area);
        frame.render_widget(self.head(status), head);
        frame.render_widget(process_table(status, table.width), table);
        frame.render_widget(latency_line(status), latency);
        self.draw_latencies(frame, spark);
        self.draw_members(frame, status, list);
        let keys = "↑↓ choose  space switch  1-9 switch  q quit";
        let foot_text = if self.message.is_empty() {
            keys
        } else {
            &self.message
        };
        frame.render_widget(Line::from(foot_text.to_owned()).dim(), foot);
    }

    fn head(&self, status: &Status) -> Line<'static> {
        let mut line = vec![
            Span::from(format!("evpr {} ", status.name)).bold(),
            Span::from(format!(
                "{} {}, tick {}, {} answers, {} places, {:.0} s",
                status.delivery,
                status.state,
                status.tick.map_or("-".to_owned(), |t| t.to_string()),
                status.answers,
                status.matches,
                status.uptime_s
            )),
        ];
        if status.progress_permille > 0 {
            line.push(Span::from(format!(", {} %", status.progress_permille / 10)));
        }
        if self.gone.is_some() {
            line.insert(1, Span::from("HAS ENDED; its last state: ").red().bold());
        }
        Line::from(line)
    }

    fn draw_latencies(&self, frame: &mut Frame<'_>, area: Rect) {
        let skipped = self.latencies.len().saturating_sub(area.width as usize);
        let shown: Vec<u64> = self.latencies.iter().skip(skipped).copied().collect();
        frame.render_widget(Sparkline::default().data(shown).style(Style::new().cyan()), area);
    }

    fn draw_members(&self, frame: &mut Frame<'_>, status: &Status, area: Rect) {
        let rows = status.members.iter().enumerate().map(|(index, m)| {
            let key = if index < 9 {
                (index + 1).to_string()
            } else {
                String::new()
            };
            let state = match (m.state.enabled, m.state.shed) {
                (true, _) => "on".green(),
                (false, true) => "shed".yellow(),
                (false, false) => "off".dark_gray(),
            };
            Row::new(vec![
                Cell::from(key),
                Cell::from(m.state.name.clone()),
                Cell::from(state),
                right(format!("{}", m.state.weight)),
                right(format!("{:.2}", m.reconstruct_ms)),
                right(format!("{:.2}", m.extract_ms)),
                right(count_text(m.rows as f64)),
            ])
        });
        let widths = [
            Constraint::Length(2),
            Constraint::Fill(1),
            Constraint::Length(4),
            Constraint::Length(6),
            Constraint::Length(9),
            Constraint::Length(10),
            Constraint::Length(6),
        ];
        let head = ["", "member", "", "weight", "frame ms", "extract ms", "rows"];
        let table = Table::new(rows, widths)
            .header(header(&head, 3))
            .row_highlight_style(Style::new().add_modifier(Modifier::REVERSED));
        let mut state = TableState::default().with_selected(Some(self.chosen));
        frame.render_stateful_widget(table, area, &mut state);
    }
}

fn right(text: String) -> Cell<'static> {
    Cell::from(Line::from(text).right_aligned())
}

/// Column titles; from the `numbers`th on they stand to the right, as the numbers below them do.
fn header(titles: &[&'static str], numbers: usize) -> Row<'static> {
    let cell = |(i, title): (usize, &&'static str)| {
        let line = Line::from(*title);
        Cell::from(if i < numbers { line } else { line.right_aligned() })
    };
    Row::new(titles.iter().enumerate().map(cell).collect::<Vec<_>>()).style(Style::new().bold().underlined())
}

fn process_table(status: &Status, width: u16) -> Table<'static> {
    let wide = width >= 130;
    let mut titles = vec![
        "process", "doing", "in/s", "out/s", "drops", "wait p99", "work p50",
    ];
    let mut widths = vec![
        Constraint::Fill(1),
        Constraint::Length(13),
        Constraint::Length(5),
        Constraint::Length(5),
        Constraint::Length(5),
        Constraint::Length(8),
        Constraint::Length(8),
    ];
    if wide {
        titles.extend(["work p99", "send p99", "age p99", "skips", "deaths", "MiB"]);
        widths.extend([8, 8, 7, 6, 6, 5].map(Constraint::Length));
    }
    titles.push("cpu%");
    widths.push(Constraint::Length(4));
    let row = |s: &ServiceStatus| {
        let drops = count_text(s.dropped as f64);
        let drops = if s.dropped > 0 {
            drops.red().bold()
        } else {
            drops.into()
        };
        let time = |us: f64| right(time_text(us));
        let name = match s.state.as_str() {
            "restarting" | "down" => s.name.clone().red(),
            _ => Span::from(s.name.clone()),
        };
        let doing = match s.doing.as_str() {
            "blocked" => doing_text(s).yellow(),
            _ => Span::from(doing_text(s)),
        };
        let mut cells = vec![
            Cell::from(name),
            Cell::from(doing),
            right(count_text(s.received_per_s)),
            right(count_text(s.emitted_per_s)),
            Cell::from(Line::from(drops).right_aligned()),
            time(s.waiting.last_10s.p99_us),
            time(s.processing.last_10s.p50_us),
        ];
        if wide {
            let deaths = s.restarts.to_string();
            let deaths = if s.restarts > 0 {
                deaths.red()
            } else {
                deaths.into()
            };
            cells.extend([
                time(s.processing.last_10s.p99_us),
                time(s.sending.last_10s.p99_us),
                time(s.age.last_10s.p99_us),
                right(count_text(s.skipped as f64)),
                Cell::from(Line::from(deaths).right_aligned()),
                right(format!("{:.0}", s.rss_bytes as f64 / f64::from(1 << 20))),
            ]);
        }
        cells.extend([right(format!("{:.0}", s.cpu_percent))]);
        Row::new(cells)
    };
    Table::new(status.services.iter().map(row).collect::<Vec<_>>(), widths).header(header(&titles, 2))
}

/// From the closing of the last window to the answer, over the last ten seconds.
fn latency_line(status: &Status) -> Line<'static> {
    let l = &status.latency;
    let total = &l.total.last_10s;
    let part = |name: &'static str, us: f64| Span::from(format!(" {name} {}", time_text(us)));
    let mut line = vec![
        Span::from("answer").bold(),
        part("p50", total.p50_us),
        part("p99", total.p99_us),
        part("max", total.max_us),
        Span::from("  p50 of").style(Style::new().fg(Color::DarkGray)),
        part("frames", l.reconstruct.last_10s.p50_us),
        part("rows", l.extract.last_10s.p50_us),
        part("fuse", l.fuse.last_10s.p50_us),
    ];
    if total.count == 0 {
        line = vec![Span::from("no answers in the last 10 s")];
    }
    Line::from(line)
}

#[cfg(test)]
mod tests {
    use super::*;
    use evpr_runtime::{MemberState, MemberStatus};
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    fn status() -> Status {
        let service = |name: &str, dropped| ServiceStatus {
            name: name.to_owned(),
            state: "ready".to_owned(),
            doing: "blocked".to_owned(),
            doing_ms: 2_500.0,
            dropped,
            ..ServiceStatus::default()
        };
        let member = |index: usize| MemberStatus {
            state: MemberState {
                name: format!("event_count@{index}ms/patch_norm"),
                enabled: index != 1,
                shed: false,
                weight: 1.0,
            },
            ..MemberStatus::default()
        };
        Status {
            name: "evpr".to_owned(),
            answers: 7,
            services: vec![service("ingest", 0), service("extract/patch_norm", 42)],
            members: (0..30).map(member).collect(),
            ..Status::default()
        }
    }

    fn drawn(view: &View, width: u16, height: u16) -> (String, bool) {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| view.draw(frame)).unwrap();
        let buffer = terminal.backend().buffer();
        let mut text = String::new();
        let mut red = false;
        for y in 0..height {
            for x in 0..width {
                let cell = &buffer[(x, y)];
                text += cell.symbol();
                red |= cell.fg == Color::Red && cell.symbol() == "4";
            }
            text += "\n";
        }
        (text, red)
    }

    #[test]
    fn it_fits_small_and_large_terminals_and_shows_drops_in_red() {
        let mut view = View::default();
        view.take(status());
        for (width, height) in [(80, 24), (200, 60), (130, 30)] {
            let (text, red) = drawn(&view, width, height);
            for word in [
                "evpr",
                "ingest",
                "extract/patch_norm",
                "blocked 2.5s",
                "q quit",
                "event_count@0ms",
            ] {
                assert!(text.contains(word), "{width}×{height}: no {word} in\n{text}");
            }
            assert!(red, "drops are red\n{text}");
        }
        for (width, height) in [(1, 1), (20, 5), (79, 7), (0, 0)] {
            drawn(&view, width, height);
        }
    }

    #[test]
    fn members_are_chosen_and_switched() {
        let mut view = View::default();
        assert_eq!(view.switch(), None);
        view.take(status());
        assert_eq!(
            view.switch(),
            Some(("event_count@0ms/patch_norm".to_owned(), false))
        );
        view.go(1);
        assert_eq!(
            view.switch(),
            Some(("event_count@1ms/patch_norm".to_owned(), true))
        );
        view.go(-5);
        assert_eq!(view.switch().unwrap().0, "event_count@0ms/patch_norm");
        view.go(500);
        assert_eq!(view.switch().unwrap().0, "event_count@29ms/patch_norm");
        assert!(view.go_to(3) && !view.go_to(30));
        assert_eq!(view.switch().unwrap().0, "event_count@3ms/patch_norm");
        // The chosen one comes into sight.
        view.go(500);
        assert!(drawn(&view, 80, 24).0.contains("event_count@29ms"));
    }

    #[test]
    fn the_last_state_of_an_instance_that_has_ended_stays() {
        let mut view = View {
            gone: Some("no instance named \"evpr\" is running".to_owned()),
            ..View::default()
        };
        assert!(drawn(&view, 80, 24).0.contains("no instance named"));
        view.take(status());
        view.gone = Some("it has gone".to_owned());
        let (text, _) = drawn(&view, 80, 24);
        assert!(text.contains("HAS ENDED") && text.contains("ingest"), "{text}");
        assert_eq!(view.switch(), None, "there is nobody to be switched");
    }
}
