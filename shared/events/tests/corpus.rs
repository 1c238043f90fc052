//! The seeds of every fuzz target, and what fuzzing found, go through the same functions as there.

#[path = "../../../fuzz/src/lib.rs"]
#[allow(unreachable_pub)] // it is a crate there
mod fuzz;

use std::fs;
use std::path::Path;

#[test]
fn every_seed_passes_its_target() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus");
    for (name, target) in fuzz::TARGETS {
        let files = fs::read_dir(corpus.join(name)).unwrap_or_else(|e| panic!("corpus/{name}: {e}"));
        let mut count = 0;
        for file in files {
            let path = file.unwrap().path();
            println!("{}", path.display());
            let data = fs::read(&path).unwrap();
            target(&data);
            // Cut off at every place, too.
            (0..data.len())
                .step_by(data.len() / 16 + 1)
                .for_each(|len| target(&data[..len]));
            count += 1;
        }
        assert!(count > 0, "corpus/{name} is empty");
    }
}
