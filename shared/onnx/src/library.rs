//! The shared library of ONNX Runtime: where it is found, and that it can be used.

use crate::error::{OnnxError, one_line};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Names the library, when the configuration does not.
pub const LIBRARY_VARIABLE: &str = "ORT_DYLIB_PATH";
/// Names the folder where scripts/get-onnxruntime puts it.
const CACHE_VARIABLE: &str = "EVPR_CACHE_DIR";
const CACHE_FOLDER: &str = ".cache";

/// ONNX Runtime, loaded.
#[derive(Clone)]
pub struct Library {
    pub(crate) environment: ort::environment::Environment,
    path: PathBuf,
}

impl std::fmt::Debug for Library {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Library")
            .field("path", &self.path)
            .finish_non_exhaustive()
    }
}

impl Library {
    /// Loads the library that is configured, or else found as [`find_library`] says.
    ///
    /// # Errors
    /// When there is none, it is no library of ONNX Runtime, or older than 1.24.
    pub fn load(configured: Option<&Path>) -> Result<Self, OnnxError> {
        let (path, origin) = find_library(configured)?;
        let wrong = |problem: String| OnnxError::Library {
            path: path.clone(),
            problem,
            origin,
        };
        if !path.is_file() {
            let problem = if path.exists() {
                "it is no file"
            } else {
                "there is no such file"
            };
            return Err(wrong(problem.to_owned()));
        }
        // An absolute path, as the loader would look for another one beside the executable first.
        let absolute = std::path::absolute(&path).map_err(|e| wrong(e.to_string()))?;
        let builder = ort::init_from(&absolute).map_err(|e| wrong(load_problem(&e)))?;
        let environment = builder
            .with_name("evpr")
            .with_telemetry(false)
            .build()
            .map_err(|e| wrong(one_line(&e)))?;
        // What is wrong comes back as an error, and is said once.
        environment.set_log_level(ort::logging::LogLevel::Fatal);
        Ok(Self { environment, path })
    }

    /// The library's file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// What is wrong, without the path, which the message has already.
fn load_problem(error: &ort::LoadDynamicError) -> String {
    match error {
        ort::LoadDynamicError::Dlopen { error, .. } => {
            let mut cause: &dyn std::error::Error = error;
            while let Some(deeper) = cause.source() {
                cause = deeper;
            }
            format!("cannot be loaded: {}", one_line(&cause))
        }
        ort::LoadDynamicError::MissingApi { .. } => "is no library of ONNX Runtime".to_owned(),
        ort::LoadDynamicError::InvalidVersionString => "does not say its version".to_owned(),
        ort::LoadDynamicError::BadVersion { version_str, .. } => {
            format!("is ONNX Runtime {}, and 1.24 is the least", one_line(version_str))
        }
    }
}

/// Finds the library: the one that is configured, else the one that `$ORT_DYLIB_PATH` names, else the newest one that
/// scripts/get-onnxruntime put into `$EVPR_CACHE_DIR`, or into `.cache` of a folder above the executable; that only if it
/// belongs to this user or to root, as nobody else shall say what is run. Also says who named it.
///
/// # Errors
/// When nobody names one, and none was fetched.
pub fn find_library(configured: Option<&Path>) -> Result<(PathBuf, &'static str), OnnxError> {
    if let Some(path) = configured {
        return Ok((path.to_path_buf(), "inference.library"));
    }
    let variable = |name| std::env::var_os(name).filter(|value| !value.is_empty());
    if let Some(path) = variable(LIBRARY_VARIABLE) {
        return Ok((PathBuf::from(path), "$ORT_DYLIB_PATH"));
    }
    let fetched = match variable(CACHE_VARIABLE) {
        Some(cache) => newest_in(Path::new(&cache)),
        None => {
            let executable = std::env::current_exe().unwrap_or_default();
            let mut above = executable.ancestors().map(|folder| folder.join(CACHE_FOLDER));
            above.find_map(|cache| newest_in(&cache))
        }
    };
    fetched
        .map(|path| (path, "inference.library"))
        .ok_or(OnnxError::NoLibrary)
}

/// A file that belongs to this user or to root.
fn is_trusted(path: &Path) -> bool {
    let found = std::fs::metadata(path).ok().filter(std::fs::Metadata::is_file);
    let own = std::fs::metadata("/proc/self").map_or(0, |m| m.uid());
    found.is_some_and(|m| m.uid() == 0 || m.uid() == own)
}

/// The library of the highest version in `cache/onnxruntime/<version>/libonnxruntime.so*`.
fn newest_in(cache: &Path) -> Option<PathBuf> {
    let entries = |folder: &Path| {
        let listed = std::fs::read_dir(folder).into_iter().flatten().flatten();
        listed.map(|entry| entry.path())
    };
    let version = |folder: &Path| -> Vec<u64> {
        let name = folder.file_name().map(|name| name.to_string_lossy().into_owned());
        let parts = name
            .as_deref()
            .unwrap_or("")
            .split('.')
            .map(|part| part.parse().ok());
        parts.collect::<Option<_>>().unwrap_or_default()
    };
    let mut folders: Vec<PathBuf> = entries(&cache.join("onnxruntime")).collect();
    folders.sort_by_key(|folder| std::cmp::Reverse(version(folder)));
    folders.iter().find_map(|folder| {
        let is_library = |path: &PathBuf| {
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
            let name = name.unwrap_or_default();
            is_trusted(path)
                && (name.starts_with("libonnxruntime.so")
                    || name.starts_with("libonnxruntime.") && name.ends_with("dylib"))
        };
        let mut libraries: Vec<PathBuf> = entries(folder).filter(is_library).collect();
        libraries.sort();
        libraries.into_iter().next()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_version_is_taken() {
        let cache = tempfile::tempdir().unwrap();
        for (version, name) in [
            ("1.9.0", "libonnxruntime.so.1.9.0"),
            ("1.32.0", "libonnxruntime.so.1.32.0"),
            ("1.40.0", "README"),
            ("partial", "libonnxruntime.so"),
        ] {
            let folder = cache.path().join("onnxruntime").join(version);
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join(name), "").unwrap();
        }
        let found = newest_in(cache.path()).unwrap();
        assert!(found.ends_with("1.32.0/libonnxruntime.so.1.32.0"), "{found:?}");
        assert_eq!(newest_in(Path::new("/nowhere")), None);
    }

    #[test]
    fn a_library_that_is_none_is_named_with_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("missing.so");
        let error = Library::load(Some(&missing)).unwrap_err().to_string();
        assert!(
            error.contains("missing.so: there is no such file; run scripts/get-onnxruntime"),
            "{error}"
        );
        let text = folder.path().join("text.so");
        std::fs::write(&text, "no library").unwrap();
        let error = Library::load(Some(&text)).unwrap_err().to_string();
        assert!(error.contains("text.so: cannot be loaded: "), "{error}");
        assert!(!error.contains('\n'), "{error}");
    }
}
