//! Pieces of the page.

use std::fmt::Write;

/// Text that may stand in HTML.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// A part of the page.
#[derive(Debug)]
pub(super) struct Section {
    pub(super) id: &'static str,
    pub(super) title: &'static str,
    /// HTML.
    pub(super) body: String,
}

impl Section {
    pub(super) fn new(id: &'static str, title: &'static str) -> Self {
        Self {
            id,
            title,
            body: String::new(),
        }
    }

    pub(super) fn add(&mut self, html: &str) {
        self.body.push_str(html);
    }

    /// A paragraph of plain text.
    pub(super) fn say(&mut self, text: &str) {
        // Writing into a string cannot fail.
        let _ = writeln!(self.body, "<p>{}</p>", escaped(text));
    }

    /// What is not there, and what to give for it.
    pub(super) fn lacks(&mut self, text: &str) {
        let _ = writeln!(self.body, "<p class=\"lacks\">{}</p>", escaped(text));
    }

    /// Pictures side by side.
    pub(super) fn pictures(&mut self, pictures: &[super::Picture]) {
        self.body.push_str("<div class=\"pictures\">");
        for picture in pictures {
            self.body.push_str(&picture.svg());
        }
        self.body.push_str("</div>\n");
    }

    pub(super) fn html(&self) -> String {
        format!(
            "<section id=\"{0}\"><h2>{1}</h2>\n{2}</section>\n",
            self.id,
            escaped(self.title),
            self.body
        )
    }
}

/// A table. Cells are plain text.
#[derive(Debug)]
pub(super) struct Table {
    heads: Vec<String>,
    rows: Vec<Vec<String>>,
    caption: String,
    /// Columns that hold words, and not numbers.
    words: Vec<usize>,
}

impl Table {
    pub(super) fn new(heads: &[&str]) -> Self {
        Self {
            heads: heads.iter().map(|h| (*h).to_owned()).collect(),
            rows: Vec::new(),
            caption: String::new(),
            words: Vec::new(),
        }
    }

    pub(super) fn row(&mut self, cells: Vec<String>) {
        self.rows.push(cells);
    }

    /// Says which columns besides the first hold words.
    pub(super) fn words(mut self, columns: &[usize]) -> Self {
        self.words = columns.to_owned();
        self
    }

    pub(super) fn caption(mut self, text: &str) -> Self {
        text.clone_into(&mut self.caption);
        self
    }

    pub(super) fn html(&self) -> String {
        let line = |cells: &[String], tag: &str| {
            let cells = cells.iter().enumerate().map(|(at, cell)| {
                let class = if self.words.contains(&at) {
                    " class=\"word\""
                } else {
                    ""
                };
                format!("<{tag}{class}>{}</{tag}>", escaped(cell))
            });
            format!("<tr>{}</tr>\n", cells.collect::<String>())
        };
        let body: String = self.rows.iter().map(|r| line(r, "td")).collect();
        let caption = match self.caption.as_str() {
            "" => String::new(),
            text => format!("<p class=\"caption\">{}</p>\n", escaped(text)),
        };
        format!(
            "<div class=\"scroll\"><table><thead>{}</thead>\n<tbody>{body}</tbody></table></div>\n{caption}",
            line(&self.heads, "th")
        )
    }
}

/// A share of 1, in per cent.
pub(super) fn percent(share: f64) -> String {
    format!("{:.1} %", share * 100.0)
}

/// A share, or a dash where there is none.
pub(super) fn percent_or_dash(share: Option<f64>) -> String {
    share.map_or_else(|| "–".to_owned(), percent)
}

/// A probability.
pub(super) fn p_value(p: Option<f64>) -> String {
    match p {
        None => "–".to_owned(),
        Some(p) if p < 1e-4 => "< 0.0001".to_owned(),
        Some(p) => format!("{p:.4}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_cannot_become_markup() {
        assert_eq!(escaped("<b>&\""), "&lt;b&gt;&amp;&quot;");
        let mut table = Table::new(&["<i>"]);
        table.row(vec!["<b>".to_owned()]);
        let html = table.caption("<u>").html();
        assert!(
            !html.contains("<i>") && !html.contains("<b>") && !html.contains("<u>"),
            "{html}"
        );
    }
}
