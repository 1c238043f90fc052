//! Bags of ROS 2: the storage in SQLite, with a table of topics and one of messages in the order they came; and the
//! folder around a storage, whose `metadata.yaml` names its files.

use super::container::{Container, Next, Topics};
use super::fields::{Layout, Short};
use super::sqlite::{Rows, Sqlite, Value, values_of};
use crate::SourceError;
use std::collections::HashMap;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

/// What describes a bag, in its folder.
const METADATA: &str = "metadata.yaml";
/// Largest description, bytes.
const MAX_METADATA_BYTES: u64 = 1 << 20;
/// Columns of a row that are looked at.
const MAX_COLUMNS: usize = 16;
const DAMAGED: &str = "holds a row that cannot be right; the recording is damaged";

/// Messages in SQLite.
pub(super) struct Bag2 {
    sqlite: Sqlite,
    topics: Topics,
    /// Topic of each number.
    numbers: HashMap<i64, usize>,
    rows: Rows,
    row: Vec<u8>,
    /// Columns of a row with the topic and the message.
    columns: [usize; 2],
}

impl Bag2 {
    pub(super) fn open(path: &Path) -> Result<Self, SourceError> {
        let sqlite = Sqlite::open(path)?;
        let (mut topics, mut numbers, mut row) = (Topics::default(), HashMap::new(), Vec::new());
        let (table, columns) = sqlite.table("topics", ["name", "type", "serialization_format"])?;
        let mut rows = sqlite.all(&table)?;
        while let Some(number) = rows.next(&sqlite, &mut row)? {
            let [name, kind, encoding] = values(&sqlite, &row, columns)?;
            let (Value::Bytes(name), Value::Bytes(kind), Value::Bytes(encoding)) = (name, kind, encoding)
            else {
                return Err(sqlite.wrong(DAMAGED));
            };
            let layout = (encoding == b"cdr").then_some(Layout::Cdr);
            let topic = topics
                .find(name, kind, layout)
                .map_err(|what| sqlite.wrong(&what))?;
            numbers.insert(number, topic);
        }
        let (table, columns) = sqlite.table("messages", ["topic_id", "data"])?;
        Ok(Self {
            rows: sqlite.all(&table)?,
            sqlite,
            topics,
            numbers,
            row,
            columns,
        })
    }
}

/// These columns of a row.
fn values<'a, const N: usize>(
    sqlite: &Sqlite,
    row: &'a [u8],
    columns: [usize; N],
) -> Result<[Value<'a>; N], SourceError> {
    let mut values = [Value::Other; MAX_COLUMNS];
    values_of(row, &mut values).map_err(|Short| sqlite.wrong(DAMAGED))?;
    Ok(columns.map(|column| values.get(column).copied().unwrap_or(Value::Other)))
}

impl Container for Bag2 {
    fn next(&mut self, _may_wait: bool) -> Result<Next, SourceError> {
        if self.rows.next(&self.sqlite, &mut self.row)?.is_none() {
            return Ok(Next::End);
        }
        let wrong = || self.sqlite.wrong(DAMAGED);
        let [topic, message] = values(&self.sqlite, &self.row, self.columns)?;
        let (Value::Number(topic), Value::Bytes(message)) = (topic, message) else {
            return Err(wrong());
        };
        let topic = self.numbers.get(&topic).ok_or_else(wrong)?;
        let start = message.as_ptr() as usize - self.row.as_ptr() as usize;
        Ok(Next::Message(*topic, start..start + message.len()))
    }

    fn chunk(&self) -> &[u8] {
        &self.row
    }

    fn path(&self) -> &Path {
        self.sqlite.path()
    }

    fn progress_permille(&self) -> u64 {
        self.rows.progress_permille(&self.sqlite)
    }

    fn topics(&self) -> &Topics {
        &self.topics
    }

    fn topics_mut(&mut self) -> &mut Topics {
        &mut self.topics
    }
}

/// Whether this is the folder of a bag.
pub(in crate::formats) fn is_folder(path: &Path) -> bool {
    path.is_dir() && path.join(METADATA).is_file()
}

/// The file of a folder that its description names, if it is just one.
pub(in crate::formats) fn storage(folder: &Path) -> Result<PathBuf, SourceError> {
    let path = folder.join(METADATA);
    let failed = |e| SourceError::read(&path, e);
    let file = std::fs::File::open(&path).map_err(failed)?;
    let mut text = Vec::new();
    file.take(MAX_METADATA_BYTES)
        .read_to_end(&mut text)
        .map_err(failed)?;
    let text = String::from_utf8_lossy(&text);
    let names = names_of(&text);
    let inside = |name: &str| {
        Path::new(name)
            .components()
            .all(|c| matches!(c, Component::Normal(_)))
    };
    match names.as_slice() {
        [one] if inside(one) => Ok(folder.join(one)),
        [one] => Err(SourceError::malformed(
            &path,
            format!(
                "names the file {}, which is not in its folder",
                one.escape_debug()
            ),
        )),
        [] => Err(SourceError::malformed(
            &path,
            "names no file under relative_file_paths; run ros2 bag reindex on the folder, or name the file itself",
        )),
        several => Err(SourceError::malformed(
            folder,
            format!(
                "is a bag in {} files; join them with ros2 bag convert, or name one of them",
                several.len()
            ),
        )),
    }
}

/// The list under `relative_file_paths`: of all that YAML can write, what the tools do.
fn names_of(text: &str) -> Vec<&str> {
    let mut lines = text.lines().map(str::trim);
    let Some(rest) = lines.find_map(|line| line.strip_prefix("relative_file_paths:")) else {
        return Vec::new();
    };
    if let Some(list) = rest.trim().strip_prefix('[') {
        let list = list.trim_end_matches(']').split(',').map(name_of);
        return list.filter(|name| !name.is_empty()).collect();
    }
    let items = lines.map_while(|line| line.strip_prefix("- "));
    items.map(name_of).collect()
}

fn name_of(item: &str) -> &str {
    item.trim().trim_matches(['"', '\''])
}

#[cfg(test)]
mod tests {
    use super::names_of;

    #[test]
    fn files_are_named_as_the_tools_write_them() {
        let block = "a:\n  relative_file_paths:\n    - \"b_0.db3\"\n    - b 1.db3\n  files:\n    - path: c\n";
        assert_eq!(names_of(block), ["b_0.db3", "b 1.db3"]);
        assert_eq!(
            names_of("  relative_file_paths: [b.mcap, 'c']\n"),
            ["b.mcap", "c"]
        );
        assert_eq!(names_of("relative_file_paths: []\n"), Vec::<&str>::new());
        assert_eq!(names_of("version: 5\n"), Vec::<&str>::new());
    }
}
