//! Charts: lines and points over two axes, bars in groups, and tables of colours. All are as wide as a phone can show.

use super::picture::{Anchor, Color, LETTERS, Picture, fitted, text_width};
use super::raster::Raster;

/// Width of a chart, pixels.
pub(super) const WIDTH: f64 = 400.0;
/// Of the part of a chart that has axes.
const HEIGHT: f64 = 250.0;
/// Room for an axis' numbers.
const LEFT: f64 = 46.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 26.0;
const BOTTOM: f64 = 40.0;
/// Height of a bar with its gap.
const BAR: f64 = 17.0;

/// An axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axis<'a> {
    pub(super) name: &'a str,
    pub(super) from: f64,
    pub(super) to: f64,
    /// Equal steps multiply; both ends are above 0 then.
    pub(super) log: bool,
}

impl<'a> Axis<'a> {
    pub(super) fn new(name: &'a str, from: f64, to: f64) -> Self {
        Self {
            name,
            from,
            to: if to > from { to } else { from + 1.0 },
            log: false,
        }
    }

    /// From 0 to 1.
    pub(super) fn share(name: &'a str) -> Self {
        Self::new(name, 0.0, 1.0)
    }

    /// Around these values, which are above 0; equal steps multiply.
    pub(super) fn log(name: &'a str, values: impl Iterator<Item = f64> + Clone) -> Self {
        let low = values.clone().fold(f64::INFINITY, f64::min).max(1e-9);
        let high = values.fold(low, f64::max);
        Self {
            name,
            from: low / 1.5,
            to: high * 1.5,
            log: true,
        }
    }

    /// Where a value lies: 0 at the beginning, 1 at the end.
    fn place(&self, value: f64) -> f64 {
        let place = if self.log {
            (value.max(1e-12) / self.from).ln() / (self.to / self.from).ln()
        } else {
            (value - self.from) / (self.to - self.from)
        };
        place.clamp(0.0, 1.0)
    }

    /// Round numbers along it.
    fn ticks(&self) -> Vec<f64> {
        if self.log {
            let (low, high) = (self.from.log10().floor() as i32, self.to.log10().ceil() as i32);
            let steps: &[f64] = if high - low > 3 { &[1.0] } else { &[1.0, 2.0, 5.0] };
            let all = (low..=high).flat_map(|e| steps.iter().map(move |s| s * 10f64.powi(e)));
            return all.filter(|t| (self.from..=self.to).contains(t)).collect();
        }
        let rough = (self.to - self.from) / 5.0;
        let unit = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|s| s * unit);
        let step = step.into_iter().find(|s| *s >= rough * 0.999).unwrap_or(rough);
        let first = (self.from / step - 1e-9).ceil() as i64;
        let last = (self.to / step + 1e-9).floor() as i64;
        (first..=last).map(|i| i as f64 * step).collect()
    }
}

/// A number as short as it can be said.
pub(super) fn short(value: f64) -> String {
    let text = match value.abs() {
        v if v >= 1e6 => return format!("{} M", short(value / 1e6)),
        v if v >= 1e4 => return format!("{} k", short(value / 1e3)),
        v if v >= 100.0 => format!("{value:.0}"),
        v if v >= 10.0 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    };
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// Things that belong together: joined, or points of their own with what each of them is.
#[derive(Debug, Clone)]
pub(super) struct Series {
    pub(super) name: String,
    pub(super) color: Color,
    pub(super) points: Vec<(f64, f64, String)>,
    pub(super) joined: bool,
}

impl Series {
    pub(super) fn line(name: String, at: usize, points: impl Iterator<Item = (f64, f64)>) -> Self {
        Self {
            name,
            color: Color::Series(at),
            points: points.map(|(x, y)| (x, y, String::new())).collect(),
            joined: true,
        }
    }
}

/// A chart with two axes.
pub(super) fn axes(name: &str, caption: &str, x: Axis<'_>, y: Axis<'_>, series: &[Series]) -> Picture {
    let mut picture = Picture::new(name, caption, WIDTH, HEIGHT);
    let (right, floor) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
    let at_x = |v: f64| LEFT + x.place(v) * (right - LEFT);
    let at_y = |v: f64| floor - y.place(v) * (floor - TOP);
    for tick in y.ticks() {
        let at = at_y(tick);
        picture.line(vec![(LEFT, at), (right, at)], Color::Grid, 1.0);
        picture.text((LEFT - 6.0, at + 4.0), &short(tick), Anchor::End, Color::Faint);
    }
    let mut free = 0.0;
    for tick in x.ticks() {
        let (at, text) = (at_x(tick), short(tick));
        let half = text_width(&text, LETTERS) / 2.0;
        picture.line(vec![(at, floor), (at, floor + 4.0)], Color::Grid, 1.0);
        // Numbers that would touch are left out.
        if at - half > free {
            picture.text((at, floor + 17.0), &text, Anchor::Middle, Color::Faint);
            free = at + half + 4.0;
        }
    }
    picture.text((LEFT, 14.0), y.name, Anchor::Start, Color::Faint);
    let middle = f64::midpoint(LEFT, right);
    picture.text((middle, HEIGHT - 6.0), x.name, Anchor::Middle, Color::Faint);
    for s in series {
        if s.joined {
            let points = s.points.iter().map(|(x, y, _)| (at_x(*x), at_y(*y)));
            picture.line(points.collect(), s.color, 2.0);
        }
        if !s.joined || s.points.len() < 12 {
            let radius = if s.joined { 3.0 } else { 4.0 };
            for (x, y, title) in &s.points {
                picture.dot((at_x(*x), at_y(*y)), radius, s.color, title);
            }
        }
    }
    let entries: Vec<_> = series.iter().map(|s| (s.name.clone(), s.color)).collect();
    picture.height = picture.legend(HEIGHT, &entries);
    picture
}

/// A bar from 0.
#[derive(Debug, Clone)]
pub(super) struct Bar {
    pub(super) series: usize,
    pub(super) value: f64,
    /// A range around it.
    pub(super) range: Option<(f64, f64)>,
    /// Shown when it is pointed at.
    pub(super) title: String,
}

/// Bars with a name in common.
#[derive(Debug, Clone)]
pub(super) struct Group {
    pub(super) name: String,
    pub(super) bars: Vec<Bar>,
}

/// Bars from left to right, groups one below the other, up to `most`.
pub(super) fn bars(
    name: &str,
    caption: &str,
    up: &str,
    most: f64,
    series: &[String],
    groups: &[Group],
) -> Picture {
    let mut picture = Picture::new(name, caption, WIDTH, 0.0);
    let (left, right) = (8.0, WIDTH - 56.0);
    let most = if most > 0.0 { most } else { 1.0 };
    let long = |value: f64| (value / most).clamp(0.0, 1.0) * (right - left);
    picture.text((left, 14.0), up, Anchor::Start, Color::Faint);
    let mut y = 20.0;
    for group in groups {
        if !group.name.is_empty() {
            y += 16.0;
            let text = fitted(&group.name, LETTERS, WIDTH - 16.0);
            picture.text((left, y), &text, Anchor::Start, Color::Ink);
            y += 5.0;
        }
        for bar in &group.bars {
            let wide = long(bar.value).max(1.0);
            let height = BAR - 3.0;
            picture.bar((left, y), (wide, height), Color::Series(bar.series), &bar.title);
            let mut end = wide;
            if let Some((low, high)) = bar.range {
                let middle = y + height / 2.0;
                let (low, high) = (left + long(low), left + long(high));
                picture.line(vec![(low, middle), (high, middle)], Color::Ink, 1.5);
                for at in [low, high] {
                    picture.line(vec![(at, middle - 3.0), (at, middle + 3.0)], Color::Ink, 1.5);
                }
                end = end.max(high - left);
            }
            let at = (left + end + 6.0, y + height - 3.0);
            picture.text(at, &short_share(bar.value, most), Anchor::Start, Color::Ink);
            y += BAR;
        }
    }
    let entries: Vec<_> = (0..)
        .map(Color::Series)
        .zip(series)
        .map(|(c, n)| (n.clone(), c))
        .collect();
    picture.height = if entries.len() > 1 {
        picture.legend(y + 6.0, &entries)
    } else {
        y + 4.0
    };
    picture
}

fn short_share(value: f64, most: f64) -> String {
    if most <= 1.0 {
        format!("{value:.3}")
    } else {
        short(value)
    }
}

/// A square table of numbers from `from` (light) to `to` (dark), with names down its side and numbers along its top.
pub(super) fn heat(
    name: &str,
    caption: &str,
    names: &[String],
    (from, to): (f64, f64),
    value: impl Fn(usize, usize) -> Option<f64>,
) -> Picture {
    let count = names.len().max(1);
    let side = (WIDTH * 0.52).min(18.0 * count as f64).max(90.0);
    let cell = side / count as f64;
    let left = WIDTH - 8.0 - side;
    let top = 24.0;
    let mut picture = Picture::new(name, caption, WIDTH, top + side + 30.0);
    let mut image = Raster::filled(count, count, [0xff; 3]);
    for (at, pixel) in image.pixels.iter_mut().enumerate() {
        *pixel = match value(at / count, at % count) {
            Some(value) => shade((value - from) / (to - from)),
            None => [0xff; 3],
        };
    }
    picture.image((left, top), (side, side), image);
    // As many names as there is room for.
    let every = (15.0 / cell).ceil().max(1.0) as usize;
    for (at, name) in names.iter().enumerate().filter(|(at, _)| at % every == 0) {
        let middle = top + (at as f64 + 0.5) * cell;
        let name = format!("{} {name}", at + 1);
        let room = left - 14.0;
        // Small letters: names of members are long.
        picture.shapes.push(super::picture::Shape::Text {
            at: (left - 6.0, middle + 3.5),
            text: fitted(&name, 10.0, room),
            size: 10.0,
            anchor: Anchor::End,
            color: Color::Ink,
        });
        let across = left + (at as f64 + 0.5) * cell;
        if cell >= 14.0 || at % (every * 2) == 0 {
            picture.text(
                (across, top - 6.0),
                &(at + 1).to_string(),
                Anchor::Middle,
                Color::Faint,
            );
        }
    }
    let mut scale = Raster::filled(64, 1, [0; 3]);
    for (at, pixel) in scale.pixels.iter_mut().enumerate() {
        *pixel = shade(at as f64 / 63.0);
    }
    let floor = top + side + 10.0;
    let wide = (side - 80.0).max(40.0);
    picture.image((left + 30.0, floor), (wide, 10.0), scale);
    picture.text(
        (left + 24.0, floor + 10.0),
        &short(from),
        Anchor::End,
        Color::Faint,
    );
    picture.text(
        (left + 36.0 + wide, floor + 10.0),
        &short(to),
        Anchor::Start,
        Color::Faint,
    );
    picture
}

/// From almost white to dark blue; the order is seen by everybody.
pub(super) fn shade(share: f64) -> [u8; 3] {
    let share = share.clamp(0.0, 1.0);
    let mix = |a: f64, b: f64| (a + (b - a) * share).round() as u8;
    [mix(244.0, 8.0), mix(247.0, 48.0), mix(250.0, 107.0)]
}

#[cfg(test)]
mod tests {
    use super::super::picture::Shape;
    use super::*;

    fn texts(picture: &Picture) -> Vec<&str> {
        picture
            .shapes
            .iter()
            .filter_map(|s| match s {
                Shape::Text { text, .. } => Some(text.as_str()),
                _ => None,
            })
            .collect()
    }

    #[test]
    fn ticks_are_round() {
        assert_eq!(
            Axis::share("").ticks(),
            [0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]
        );
        assert_eq!(Axis::new("", 5.0, 70.0).ticks(), [20.0, 40.0, 60.0]);
        assert_eq!(
            Axis::log("", [3.0, 60.0].into_iter()).ticks(),
            [2.0, 5.0, 10.0, 20.0, 50.0]
        );
        let alone = Axis::new("", 3.0, 3.0);
        assert!(alone.place(3.0) == 0.0 && !alone.ticks().is_empty());
    }

    #[test]
    fn numbers_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (0.6000000000000001, "0.6"),
            (12.34, "12.3"),
            (100.0, "100"),
            (250_000.0, "250 k"),
            (1.5e6, "1.5 M"),
        ] {
            assert_eq!(short(value), text);
        }
    }

    #[test]
    fn longer_bars_are_longer_and_say_how_long() {
        let bar = |value| Bar {
            series: 0,
            value,
            range: None,
            title: String::new(),
        };
        let groups = [Group {
            name: "pair".to_owned(),
            bars: vec![bar(0.25), bar(0.5)],
        }];
        let picture = bars("b", "", "share", 1.0, &["one".to_owned()], &groups);
        let lengths: Vec<f64> = picture
            .shapes
            .iter()
            .filter_map(|s| match s {
                Shape::Bar { size, .. } => Some(size.0),
                _ => None,
            })
            .collect();
        assert_eq!(lengths[1], 2.0 * lengths[0]);
        assert_eq!(texts(&picture), ["share", "pair", "0.250", "0.500"]);
    }

    #[test]
    fn everything_is_inside() {
        let wild = Series {
            name: "n".repeat(200),
            color: Color::Series(0),
            points: vec![(-5.0, 9.0, String::new()), (f64::MAX, -1.0, String::new())],
            joined: true,
        };
        let picture = axes("a", "", Axis::share("x"), Axis::share("y"), &[wild]);
        for shape in &picture.shapes {
            match shape {
                Shape::Line { points, .. } => {
                    assert!(
                        points
                            .iter()
                            .all(|(x, y)| (0.0..=WIDTH).contains(x) && (0.0..=picture.height).contains(y))
                    );
                }
                Shape::Text {
                    at,
                    text,
                    size,
                    anchor: Anchor::Start,
                    ..
                } => {
                    assert!(at.0 + text_width(text, *size) <= WIDTH, "{text}");
                }
                _ => {}
            }
        }
    }
}
