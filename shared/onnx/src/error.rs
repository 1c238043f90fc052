//! What can go wrong with a network, each in one line that says what to do.

use std::path::PathBuf;

/// Why a network cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum OnnxError {
    /// There is no library to load.
    #[error(
        "no library of ONNX Runtime was found; run scripts/get-onnxruntime, or name one with inference.library or ${}",
        crate::LIBRARY_VARIABLE
    )]
    NoLibrary,
    /// The library that was named or found cannot be loaded.
    #[error("{path}: {problem}; run scripts/get-onnxruntime, or name another with {origin}")]
    Library {
        /// The library.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
        /// Who named it.
        origin: &'static str,
    },
    /// The registry of models cannot be read.
    #[error("{path}: {problem}")]
    Registry {
        /// The registry's file.
        path: PathBuf,
        /// What is wrong, where, and what to write.
        problem: String,
    },
    /// The model's file is not what the registry says.
    #[error("model \"{id}\": {path}: {problem}")]
    Model {
        /// Its name in the registry.
        id: String,
        /// Its file.
        path: PathBuf,
        /// What is wrong and what to do.
        problem: String,
    },
    /// A provider cannot start.
    #[error(
        "model \"{id}\": the provider \"{provider}\" cannot start: {problem}; correct it, leave it out of \
         inference.providers, or write inference.fallback = true"
    )]
    Provider {
        /// The model's name in the registry.
        id: String,
        /// The provider.
        provider: &'static str,
        /// What ONNX Runtime says.
        problem: String,
    },
    /// The network failed on this input; it may do on others.
    #[error("{0}")]
    Run(String),
}

impl OnnxError {
    /// What is wrong, without what to do about it.
    pub(crate) fn problem(&self) -> String {
        match self {
            Self::Provider { problem, .. } => problem.clone(),
            other => other.to_string(),
        }
    }
}

/// What ONNX Runtime says, on one line and not longer than a line should be.
pub(crate) fn one_line(error: &dyn std::fmt::Display) -> String {
    const LONGEST: usize = 400;
    let text = error.to_string();
    let words: Vec<&str> = text.split_whitespace().collect();
    let mut line = words.join(" ");
    if line.len() > LONGEST {
        let cut = (0..=LONGEST).rev().find(|at| line.is_char_boundary(*at));
        line.truncate(cut.unwrap_or(0));
        line.push('…');
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_one_line_of_limited_length() {
        assert_eq!(one_line(&"a\n  b\tc"), "a b c");
        let long = one_line(&"é".repeat(1000));
        assert!(long.len() < 410 && long.ends_with('…'));
    }
}
