//! The report's folder: which one may be written to, and what is where in it.

use super::setup::CONFIG_NAME;
use crate::failure::Failure;
use evpr_core::plan::StreetPass;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// The page.
pub(crate) const PAGE: &str = "index.html";
/// All numbers.
pub(crate) const RESULTS: &str = "results.json";
/// The pictures.
pub(crate) const FRAMES: &str = "frames.png";
/// Fused scores of the second drive by day.
pub(crate) const SIMILARITY_DAY: &str = "similarity_day.png";
/// Fused scores of the drive by night.
pub(crate) const SIMILARITY_NIGHT: &str = "similarity_night.png";
/// Recall@1 of the ensembles.
pub(crate) const RECALL: &str = "recall.png";
/// Latency of the stages.
pub(crate) const LATENCY: &str = "latency.png";

const TRAVERSES: &str = "traverses";
const MATCHES: &str = "matches";
/// A file that only a report has: by it one is known, a half-written one too.
const MARK: &str = ".evpr-demo";

/// Everything that a report consists of.
const FILES: [&str; 8] = [
    PAGE,
    RESULTS,
    FRAMES,
    SIMILARITY_DAY,
    SIMILARITY_NIGHT,
    RECALL,
    LATENCY,
    CONFIG_NAME,
];
const FOLDERS: [&str; 2] = [TRAVERSES, MATCHES];

/// A report's folder.
#[derive(Debug)]
pub(crate) struct ReportFolder {
    path: PathBuf,
}

impl ReportFolder {
    /// Makes the folder, or empties that of an earlier report. What does not belong to the report stays.
    ///
    /// # Errors
    /// When there is something else under this name, or it cannot be written.
    pub(crate) fn create(path: &Path) -> Result<Self, Failure> {
        let failed = |e: io::Error| Failure::new(format!("cannot write {}: {e}", path.display()));
        match fs::read_dir(path) {
            Ok(mut entries) => {
                if entries.next().is_some() && !path.join(MARK).is_file() {
                    return Err(Failure::new(format!(
                        "{} is not empty and holds no report of evpr demo; choose another folder with --out",
                        path.display()
                    )));
                }
            }
            Err(e) if e.kind() == io::ErrorKind::NotFound => fs::create_dir_all(path).map_err(failed)?,
            Err(e) if e.kind() == io::ErrorKind::NotADirectory => {
                return Err(Failure::new(format!(
                    "{} is a file; choose another folder with --out",
                    path.display()
                )));
            }
            Err(e) => return Err(failed(e)),
        }
        fs::write(
            path.join(MARK),
            "A report of evpr demo. The next one replaces it.\n",
        )
        .map_err(failed)?;
        for file in FILES {
            gone(fs::remove_file(path.join(file))).map_err(failed)?;
        }
        for folder in FOLDERS {
            gone(fs::remove_dir_all(path.join(folder))).map_err(failed)?;
            fs::create_dir(path.join(folder)).map_err(failed)?;
        }
        Ok(Self {
            path: path.to_owned(),
        })
    }

    /// A file of the report.
    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// The rows of a drive; those of the first by day are the map.
    pub(crate) fn traverse(&self, pass: StreetPass) -> PathBuf {
        self.path.join(TRAVERSES).join(pass.name())
    }

    /// The answers of a drive.
    pub(crate) fn matches(&self, pass: StreetPass) -> PathBuf {
        self.path.join(MATCHES).join(format!("{}.jsonl", pass.name()))
    }

    /// Writes a file of the report.
    ///
    /// # Errors
    /// When it cannot be written.
    pub(crate) fn write(&self, name: &str, text: &str) -> Result<(), Failure> {
        let path = self.file(name);
        fs::write(&path, text).map_err(|e| Failure::new(format!("cannot write {}: {e}", path.display())))
    }
}

/// What is not there need not be removed.
fn gone(removed: io::Result<()>) -> io::Result<()> {
    match removed {
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_earlier_report_is_replaced_and_nothing_else_is_touched() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("new/report");
        let report = ReportFolder::create(&path).unwrap();
        report.write(RESULTS, "{}").unwrap();
        report.write("notes.txt", "mine").unwrap();
        fs::write(report.matches(StreetPass::Night), "").unwrap();
        let report = ReportFolder::create(&path).unwrap();
        assert!(!report.file(RESULTS).exists());
        assert!(!report.matches(StreetPass::Night).exists());
        assert!(report.file("notes.txt").exists());
    }

    #[test]
    fn a_folder_of_somebody_else_is_refused_and_an_empty_one_is_not() {
        let dir = tempfile::tempdir().unwrap();
        ReportFolder::create(dir.path()).unwrap();
        let other = tempfile::tempdir().unwrap();
        fs::write(other.path().join(RESULTS), "mine").unwrap();
        assert!(ReportFolder::create(other.path()).is_err());
        assert_eq!(fs::read_to_string(other.path().join(RESULTS)).unwrap(), "mine");
        assert!(!other.path().join(MARK).exists());
        assert!(ReportFolder::create(&other.path().join(RESULTS)).is_err());
    }
}
