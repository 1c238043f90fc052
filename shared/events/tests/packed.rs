//! Recordings inside gzip and zip.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // a broken fixture must fail the test

use evpr_events::{RawEvent, ReadOptions, SourceError};
use flate2::Compression;
use flate2::write::{DeflateEncoder, GzEncoder};
use std::io::Write;
use std::path::Path;

const TEXT: &str = "346 260\n0.000001 1 2 1\n0.000003 3 4 0\n";

fn gz(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// A member: name, flags, method, bytes.
type Member<'a> = (&'a str, u16, u16, &'a [u8]);

fn zip(members: &[Member<'_>]) -> Vec<u8> {
    let (mut out, mut directory) = (Vec::new(), Vec::new());
    for (name, flags, method, bytes) in members {
        let packed = if *method == 8 {
            let mut encoder = DeflateEncoder::new(Vec::new(), Compression::fast());
            encoder.write_all(bytes).unwrap();
            encoder.finish().unwrap()
        } else {
            bytes.to_vec()
        };
        let mut common = [&[20, 0], &flags.to_le_bytes()[..], &method.to_le_bytes(), &[0; 4]].concat();
        common.extend(crc32fast::hash(bytes).to_le_bytes());
        common.extend((packed.len() as u32).to_le_bytes());
        common.extend((bytes.len() as u32).to_le_bytes());
        common.extend((name.len() as u16).to_le_bytes());
        common.extend([0; 2]);
        let at = out.len() as u32;
        directory.extend(
            [
                b"PK\x01\x02\x14\x00",
                &common[..],
                &[0; 10],
                &at.to_le_bytes(),
                name.as_bytes(),
            ]
            .concat(),
        );
        out.extend([b"PK\x03\x04", &common[..], name.as_bytes(), &packed].concat());
    }
    let count = (members.len() as u16).to_le_bytes();
    let (at, len) = (out.len() as u32, directory.len() as u32);
    out.extend(directory);
    out.extend(
        [
            b"PK\x05\x06\x00\x00\x00\x00",
            &count[..],
            &count,
            &len.to_le_bytes(),
            &at.to_le_bytes(),
            &[0; 2],
        ]
        .concat(),
    );
    out
}

fn read_named(
    dir: &Path,
    name: &str,
    bytes: &[u8],
    stream: Option<&str>,
) -> Result<Vec<RawEvent>, SourceError> {
    let path = dir.join(name);
    std::fs::write(&path, bytes).unwrap();
    let options = ReadOptions {
        stream: stream.map(str::to_owned),
        ..ReadOptions::default()
    };
    let mut recording = evpr_events::open(&path, &options)?;
    let (mut all, mut batch) = (Vec::new(), Vec::new());
    while recording.next_batch(&mut batch)? {
        all.extend_from_slice(&batch);
    }
    Ok(all)
}

fn read(name: &str, bytes: &[u8]) -> Result<Vec<RawEvent>, SourceError> {
    read_named(tempfile::tempdir().unwrap().path(), name, bytes, None)
}

fn wants() -> Vec<RawEvent> {
    let event = |t_ns, x, y, on| RawEvent { t_ns, x, y, on };
    vec![event(1_000, 1, 2, true), event(3_000, 3, 4, false)]
}

#[test]
fn gzip_and_zip_are_unpacked() {
    let text = TEXT.as_bytes();
    assert_eq!(read("a.txt.gz", &gz(text)).unwrap(), wants());
    assert_eq!(read("a.gz", &gz(text)).unwrap(), wants());
    // Two parts, as of gzip files put together.
    let (one, two) = text.split_at(20);
    assert_eq!(read("a.txt.gz", &[gz(one), gz(two)].concat()).unwrap(), wants());
    for method in [0, 8] {
        let alone = zip(&[("folder/", 0, 0, b""), ("folder/a.txt", 0, method, text)]);
        assert_eq!(read("a.zip", &alone).unwrap(), wants());
        let among = zip(&[
            ("images.txt", 0, 8, b"0.1 images/0.png"),
            ("__MACOSX/events.txt", 0, 0, b"junk"),
            ("events.txt", 0, method, text),
        ]);
        assert_eq!(read("a.zip", &among).unwrap(), wants());
        let two = zip(&[
            ("left.csv", 0, method, text),
            ("right.csv", 0, method, b"1 1 1 0"),
        ]);
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(
            read_named(dir.path(), "a.zip", &two, Some("left.csv")).unwrap(),
            wants()
        );
    }
    // A comment may hold what the end of an archive begins with.
    let mut commented = zip(&[("a.txt", 0, 8, text)]);
    let len = commented.len();
    commented[len - 2] = 3;
    commented.extend(b"abc");
    assert_eq!(read("a.zip", &commented).unwrap(), wants());
}

#[test]
fn a_flood_of_zeros_is_only_a_bad_line() {
    let flood = gz(&vec![b'0'; 64 << 20]);
    assert!(flood.len() < 1 << 20);
    let said = read("a.txt.gz", &flood).unwrap_err().to_string();
    assert!(said.contains("longer than 64 KiB"), "{said}");
}

#[test]
fn bad_archives_are_refused_in_one_line() {
    let text = TEXT.as_bytes();
    let good = zip(&[("a.txt", 0, 0, text)]);
    let mut flipped = good.clone();
    flipped[40] ^= 1;
    let mut moved = good.clone();
    let len = moved.len();
    moved[len - 6] ^= 0x80;
    let (cut_gz, cut_zip) = (gz(text), zip(&[("a.txt", 0, 0, text)]));
    let many: Vec<String> = (0..9).map(|i| format!("{i}.csv")).collect();
    let many: Vec<Member<'_>> = many.iter().map(|n| (n.as_str(), 0, 0, text)).collect();
    for (name, bytes, wants) in [
        ("a.txt.gz", cut_gz[..cut_gz.len() - 9].to_vec(), "cannot be read"),
        ("a.txt.gz", b"0.1 1 1 1".to_vec(), "not its signature"),
        ("a.gz.gz", gz(&gz(text)), "packed twice"),
        ("a.h5.gz", gz(b"\x89HDF\r\n\x1a\n"), "unpack it into a file"),
        ("a.bin.gz", gz(&[0; 99]), "of no known format"),
        ("a.zip", cut_zip[..cut_zip.len() - 1].to_vec(), "cut short"),
        ("a.zip", b"PK\x03\x04".to_vec(), "cut short"),
        ("a.zip", moved, "cut short"),
        ("a.zip", flipped, "checksum"),
        ("a.zip", zip(&[("a.txt", 1, 0, text)]), "a.txt is encrypted"),
        ("a.zip", zip(&[("a.txt", 0, 93, text)]), "compressed by method 93"),
        ("a.zip", zip(&[("a.zip", 0, 0, &good)]), "packed twice"),
        (
            "a.zip",
            zip(&[("a.h5", 0, 0, b"x"), ("b.md", 0, 0, b"x")]),
            "no recording that can be read in order, but a.h5, b.md",
        ),
        ("a.zip", zip(&[("a/", 0, 0, b"")]), "but nothing at all"),
        (
            "a.zip",
            zip(&many),
            "several files that may be the recording (0.csv, 1.csv, 2.csv, 3.csv, 4.csv, 5.csv, …)",
        ),
        (
            "a.npz",
            zip(&[("t.npy", 0, 0, b"x"), ("x.npy", 0, 0, b"x")]),
            "no .npy header",
        ),
        (
            "a.npz",
            zip(&[("q.npy", 0, 0, b"x"), ("x.npy", 0, 0, b"x")]),
            "has no array t among q, x",
        ),
    ] {
        let said = read(name, &bytes).unwrap_err().to_string();
        assert!(said.contains(wants), "{said}\nwants {wants}");
        assert!(said.contains(name) && !said.contains('\n'), "{said}");
    }
    let dir = tempfile::tempdir().unwrap();
    let said = read_named(dir.path(), "a.zip", &good, Some("b.txt"))
        .unwrap_err()
        .to_string();
    assert!(said.contains("holds no b.txt, but a.txt"), "{said}");
}

/// Flipping any byte of an archive never makes the reader panic or give events that were not there.
#[test]
fn any_damage_is_noticed_or_harmless() {
    let text = TEXT.as_bytes();
    for (name, good) in [("a.zip", zip(&[("a.txt", 0, 8, text)])), ("a.txt.gz", gz(text))] {
        let dir = tempfile::tempdir().unwrap();
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 0x55;
            if let Ok(events) = read_named(dir.path(), name, &bad, None) {
                assert!(events == wants(), "{name}: byte {at}");
            }
        }
    }
}
