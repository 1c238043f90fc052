//! What the tests do with the targets: every file of the corpus, whole and cut off at many places.

use std::fs;
use std::path::Path;

/// A target: its name, which is also its folder's in `corpus`, and what it does with bytes.
pub type Target = (&'static str, fn(&[u8]));

/// Replays the seeds of every fuzz target, and what fuzzing found. Of a long file, 16 beginnings.
///
/// # Panics
/// When a target does, or has no seeds.
pub fn corpus(targets: &[Target]) {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus");
    for (name, target) in targets {
        let files = fs::read_dir(corpus.join(name)).into_iter().flatten().flatten();
        let mut count = 0;
        for file in files {
            println!("{}", file.path().display());
            let data = fs::read(file.path()).unwrap_or_default();
            target(&data);
            (0..data.len())
                .step_by(data.len() / 16 + 1)
                .for_each(|len| target(&data[..len]));
            count += 1;
        }
        assert!(count > 0, "corpus/{name} is empty");
    }
}
