//! Images and stacks and lists of them.

use crate::replay::Target;
use evpr_core::plan::{FrameSource, OnOtherSize, Sensor, Source, StackOrder};
use evpr_frames::{FrameList, Picture};
use std::path::PathBuf;
use std::{env, fs, process, thread};

/// Every target of this module.
pub const TARGETS: &[Target] = &[
    ("frame_list", frame_list),
    ("frame_stack", frame_stack),
    ("image", image),
];

/// A PNG or JPEG file, at its own size and resized.
pub fn image(data: &[u8]) {
    let folder = Folder::with("f.png", data);
    read(&folder.0, FrameSource::default());
    let resized = FrameSource {
        on_other_size: OnOtherSize::Resize,
        size: Some(Sensor { height: 3, width: 5 }),
        ..FrameSource::default()
    };
    read(&folder.0, resized);
}

/// A `.npy` stack.
pub fn frame_stack(data: &[u8]) {
    let folder = Folder::with("f.npy", data);
    for stack_order in [StackOrder::Rgb, StackOrder::Bgr] {
        let options = FrameSource {
            stack_order,
            ..FrameSource::default()
        };
        read(&folder.0.join("f.npy"), options);
    }
}

/// A list of files that are not there.
pub fn frame_list(data: &[u8]) {
    let folder = Folder::with("f.csv", data);
    read(&folder.0.join("f.csv"), FrameSource::default());
}

/// Reads the first frames.
fn read(path: &std::path::Path, options: FrameSource) {
    const FRAMES: usize = 4;
    let one_line = |e: evpr_frames::FrameError| assert!(!e.to_string().contains('\n'), "{e}");
    let mut list = match FrameList::open(&Source::frames(path, options)) {
        Ok(list) => list,
        Err(e) => return one_line(e),
    };
    assert!(!list.is_empty());
    let size = match list.size() {
        Ok(size) => size,
        Err(e) => return one_line(e),
    };
    let mut picture = Picture::default();
    for frame in 0..list.len().min(FRAMES) {
        if let Err(e) = list.check(frame, size) {
            one_line(e);
        }
        match list.read(frame, size, &mut picture) {
            Ok(()) => assert_eq!(picture.pixels.len(), size.pixels() * picture.order.channels()),
            Err(e) => one_line(e),
        }
    }
}

/// A folder with one file, for as long as this lives.
struct Folder(PathBuf);

impl Folder {
    fn with(name: &str, data: &[u8]) -> Self {
        let (process, thread) = (process::id(), thread::current().id());
        let path = env::temp_dir().join(format!("evpr-fuzz-frames-{process}-{thread:?}"));
        let _ = fs::create_dir(&path);
        assert!(
            fs::write(path.join(name), data).is_ok(),
            "{} cannot be written",
            path.display()
        );
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}
