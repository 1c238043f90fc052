//! Images that another program wrote: `fixtures/make_fixtures.py`.
#![allow(clippy::unwrap_used, clippy::panic)] // helpers of tests are tests

use evpr_core::message::ChannelOrder;
use evpr_core::plan::{FrameSource, OnOtherSize, Sensor, Source, StackOrder};
use evpr_frames::{FrameError, FrameList, Picture};
use std::path::{Path, PathBuf};

const SIZE: Sensor = Sensor { height: 8, width: 16 };
/// Of 0.299 · 254 and 0.114 · 254.
const GREY: [u8; 2] = [76, 29];

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures")
        .join(name)
}

/// A list of one file.
fn list_of(file: &Path, frames: FrameSource) -> (tempfile::TempDir, FrameList) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("list.csv");
    std::fs::write(&path, format!("file\n{}\n", file.display())).unwrap();
    let list = FrameList::open(&Source::frames(path, frames)).unwrap();
    (folder, list)
}

fn read(file: &Path) -> Result<Picture, FrameError> {
    let (_folder, mut list) = list_of(file, FrameSource::default());
    assert_eq!(list.len(), 1);
    assert_eq!(list.size()?, SIZE);
    list.check(0, SIZE)?;
    let mut picture = Picture::default();
    list.read(0, SIZE, &mut picture)?;
    Ok(picture)
}

fn stack(descr: &str, shape: &str, data: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.npy");
    let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes.extend(data);
    std::fs::write(&path, bytes).unwrap();
    (folder, path)
}

#[test]
fn colours_come_as_blue_green_red() {
    for (name, tolerance) in [
        ("colour.png", 0),
        ("palette.png", 0),
        ("alpha.png", 0),
        ("colour.jpg", 3),
        ("progressive.jpg", 3),
    ] {
        let picture = read(&fixture(name)).unwrap();
        assert_eq!(
            (picture.order, picture.pixels.len()),
            (ChannelOrder::BlueGreenRed, 8 * 16 * 3)
        );
        for (at, pixel) in picture.pixels.chunks(3).enumerate() {
            let expected = if at % 16 < 8 { [0u8, 0, 254] } else { [254, 0, 0] };
            let near = pixel
                .iter()
                .zip(expected)
                .all(|(a, b)| a.abs_diff(b) <= tolerance);
            assert!(near, "{name}: pixel {at} is {pixel:?}, not {expected:?}");
        }
    }
}

#[test]
fn grey_images_have_one_channel() {
    for (name, tolerance, values) in [
        ("grey.png", 0, GREY),
        ("grey_alpha.png", 0, GREY),
        ("grey.jpg", 2, GREY),
        ("one_bit.png", 0, [255, 0]),
    ] {
        let picture = read(&fixture(name)).unwrap();
        assert_eq!(
            (picture.order, picture.pixels.len()),
            (ChannelOrder::Grey, 8 * 16)
        );
        for (at, value) in picture.pixels.iter().enumerate() {
            assert!(
                value.abs_diff(values[at / 8 % 2]) <= tolerance,
                "{name}: pixel {at} is {value}"
            );
        }
    }
}

#[test]
fn what_is_no_frame_is_named() {
    for (name, what) in [
        ("sixteen_bits.png", "has 16 bits per channel"),
        ("cmyk.jpg", "has 4 channels"),
        ("make_fixtures.py", "is neither a PNG nor a JPEG image"),
        ("nothing.png", "does not exist"),
    ] {
        let error = read(&fixture(name)).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains(what), "{error}");
    }
}

#[test]
fn every_image_that_is_cut_short_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for name in [
        "colour.png",
        "palette.png",
        "colour.jpg",
        "progressive.jpg",
        "grey.jpg",
    ] {
        let bytes = std::fs::read(fixture(name)).unwrap();
        for len in (0..bytes.len()).step_by(7).chain([bytes.len() - 1]) {
            let path = folder.path().join(name);
            std::fs::write(&path, &bytes[..len]).unwrap();
            let (_list, list) = list_of(&path, FrameSource::default());
            let checked = list.size().and_then(|_| list.check(0, SIZE));
            let error = checked.unwrap_err().to_string();
            assert!(
                error.contains("is cut short") || error.contains("damaged"),
                "{name} {len}: {error}"
            );
        }
    }
}

#[test]
fn damage_anywhere_gives_an_error_or_an_image() {
    let folder = tempfile::tempdir().unwrap();
    for name in [
        "colour.png",
        "palette.png",
        "colour.jpg",
        "progressive.jpg",
        "cmyk.jpg",
    ] {
        let bytes = std::fs::read(fixture(name)).unwrap();
        for at in 0..bytes.len() {
            let mut bad = bytes.clone();
            bad[at] ^= 0xff;
            let path = folder.path().join(name);
            std::fs::write(&path, bad).unwrap();
            let resize = FrameSource {
                on_other_size: OnOtherSize::Resize,
                ..FrameSource::default()
            };
            let (_list, mut list) = list_of(&path, resize);
            let mut picture = Picture::default();
            match list.read(0, SIZE, &mut picture) {
                Ok(()) => assert_eq!(picture.pixels.len(), SIZE.pixels() * picture.order.channels()),
                Err(error) => assert!(!error.to_string().contains('\n')),
            }
        }
    }
}

#[test]
fn another_size_is_refused_or_resized() {
    let small = Sensor { height: 4, width: 2 };
    let mut picture = Picture::default();
    let (_folder, mut list) = list_of(&fixture("grey.png"), FrameSource::default());
    let error = list.read(0, small, &mut picture).unwrap_err().to_string();
    assert!(
        error.contains("grey.png: is 8×16 (height × width) pixels") && error.contains("on_other_size"),
        "{error}"
    );
    assert!(list.check(0, small).is_err());
    let resize = FrameSource {
        on_other_size: OnOtherSize::Resize,
        size: Some(small),
        ..FrameSource::default()
    };
    let (_folder, mut list) = list_of(&fixture("grey.png"), resize);
    assert_eq!(list.size().unwrap(), small);
    list.check(0, small).unwrap();
    list.read(0, small, &mut picture).unwrap();
    assert_eq!(picture.pixels, GREY.repeat(4));
}

#[test]
fn stacks_are_read_frame_by_frame() {
    let data: Vec<u8> = (0..24).collect();
    let (_folder, path) = stack("|u1", "(2, 2, 2, 3)", &data);
    let size = Sensor { height: 2, width: 2 };
    for (stack_order, expected) in [
        (StackOrder::Bgr, [12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23]),
        (StackOrder::Rgb, [14, 13, 12, 17, 16, 15, 20, 19, 18, 23, 22, 21]),
    ] {
        let frames = FrameSource {
            stack_order,
            ..FrameSource::default()
        };
        let mut list = FrameList::open(&Source::frames(&path, frames)).unwrap();
        assert_eq!((list.len(), list.size().unwrap()), (2, size));
        let mut picture = Picture::default();
        list.read(1, size, &mut picture).unwrap();
        assert_eq!(
            (picture.order, picture.pixels.as_slice()),
            (ChannelOrder::BlueGreenRed, expected.as_slice())
        );
        assert!(list.read(2, size, &mut picture).is_err());
    }
    for (descr, shape, bytes, what) in [
        ("<f4", "(1, 2, 3)", 24, "holds <f4, not uint8"),
        ("|u1", "(4, 6)", 24, "has the shape [4, 6]"),
        ("|u1", "(1, 2, 3, 4)", 24, "has the shape [1, 2, 3, 4]"),
        ("|u1", "(0, 2, 3)", 0, "write at least one frame"),
        (
            "|u1",
            "(2, 2, 6)",
            23,
            "which is not what its shape [2, 2, 6] needs",
        ),
        (
            "|u1",
            "(9, 99999999999, 99999999999)",
            24,
            "write at least one frame",
        ),
        (
            "|u1",
            "(18446744073709551615, 2, 6)",
            24,
            "which is not what its shape",
        ),
    ] {
        let (_folder, path) = stack(descr, shape, &data[..bytes]);
        let error = FrameList::open(&Source::frames(&path, FrameSource::default()))
            .unwrap_err()
            .to_string();
        assert!(error.contains(what), "{error}");
    }
}

#[test]
fn folders_are_in_the_order_of_names() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["f10.png", "f9.PNG", "f11.jpg"] {
        let from = fixture(if name.ends_with("jpg") {
            "colour.jpg"
        } else {
            "grey.png"
        });
        std::fs::copy(from, folder.path().join(name)).unwrap();
    }
    std::fs::copy(fixture("colour.png"), folder.path().join("f8.png")).unwrap();
    std::fs::write(folder.path().join("readme.txt"), "").unwrap();
    std::fs::create_dir(folder.path().join("more.png")).unwrap();
    let mut list = FrameList::open(&Source::frames(folder.path(), FrameSource::default())).unwrap();
    assert_eq!(list.len(), 4);
    let mut picture = Picture::default();
    let mut orders = Vec::new();
    for frame in 0..4 {
        list.read(frame, SIZE, &mut picture).unwrap();
        orders.push(picture.order);
    }
    let (grey, colour) = (ChannelOrder::Grey, ChannelOrder::BlueGreenRed);
    assert_eq!(orders, [colour, grey, grey, colour]);
}
