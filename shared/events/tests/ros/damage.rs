//! Files that were cut off, damaged, or not closed.

use super::files::{bag, bag_record, mcap, packet};
use super::{events, fixture, read};
use proptest::prelude::*;

const PACKET: &str = "event_camera_msgs/EventPacket";

fn mono(n: u64) -> Vec<Vec<u8>> {
    (0..n).map(|seq| packet(seq, 1, 0, "mono", &[0; 8])).collect()
}

#[test]
fn what_was_not_closed_is_read_and_said() {
    let got = read(&bag(PACKET, &mono(3), false));
    assert!(
        got.events.len() == 3 && got.error().contains("was not closed"),
        "{got:?}"
    );
    assert!(got.error().contains("rosbag reindex"), "{got:?}");
    // As a recorder leaves it that is stopped in a chunk: without the size of the chunk.
    let mut open = bag(PACKET, &mono(2), false);
    open.extend(bag_record(
        &[("op", &[5]), ("compression", b"none"), ("size", &[0; 4])],
        &[],
    ));
    open.extend(bag_record(
        &[("op", &[2]), ("conn", &[0; 4]), ("time", &[0; 8])],
        &mono(1)[0],
    ));
    let got = read(&open);
    assert!(
        got.events.len() == 2 && got.error().contains("rosbag reindex"),
        "{got:?}"
    );
    let mut whole = mcap(PACKET, &mono(3));
    whole.truncate(whole.len() - 13);
    let got = read(&whole);
    assert!(
        got.events.len() == 3 && got.error().contains("mcap recover"),
        "{got:?}"
    );
}

#[test]
fn what_was_cut_off_is_read_up_to_there() {
    for (whole, tool) in [
        (bag(PACKET, &mono(3), true), "rosbag reindex"),
        (mcap(PACKET, &mono(3)), "mcap recover"),
    ] {
        let all = read(&whole);
        assert_eq!((all.error, all.events.len()), (None, 3));
        let mut most = 0;
        for len in 0..whole.len() {
            let got = read(&whole[..len]);
            assert!(got.events.len() >= most, "less at {len}");
            most = got.events.len();
            let rest = &whole[len..];
            // The index, or the record behind the last message, may be missing.
            let ends = got.error.is_none();
            assert!(
                !ends || most == 3,
                "nothing is said at {len}, {} bytes before the end",
                rest.len()
            );
            if let Some(error) = got.error.filter(|_| most > 0) {
                assert!(error.contains(tool), "{len}: {error}");
            }
        }
        assert_eq!(most, 3);
    }
}

#[test]
fn claims_of_size_are_not_believed() {
    let head = b"#ROSBAG V2.0\n".to_vec();
    let chunk = |compression: &[u8], size: u32, body: &[u8]| {
        let size = size.to_le_bytes();
        let record = bag_record(
            &[("op", &[5]), ("compression", compression), ("size", &size)],
            body,
        );
        read(&[&head[..], &record].concat()).error.unwrap()
    };
    assert!(chunk(b"none", u32::MAX, &[0; 9]).contains("more than 64 MiB"));
    assert!(chunk(b"none", 8, &[0; 9]).contains("has 9 bytes, but should have 8"));
    assert!(chunk(b"lz4", 8, &[0; 9]).contains("is not an LZ4 frame"));
    assert!(chunk(b"bz2", 8, &[0; 9]).contains("is not bzip2 data"));
    assert!(chunk(b"zstd", 8, &[0; 9]).contains("compression \"zstd\", which is unknown"));
    assert!(
        read(&[&head[..], &[255; 8]].concat())
            .error()
            .contains("more than 1 MiB")
    );
    assert!(read(b"#ROSBAG V1.2\n").error().contains("rosbag fix"));
    let magic = b"\x89MCAP0\r\n";
    let long = [&magic[..], &[5], &u64::MAX.to_le_bytes()].concat();
    assert!(read(&long).error().contains("more than 64 MiB"));
    let other = [&magic[..], &[77], &u64::MAX.to_le_bytes()].concat();
    assert!(read(&other).error().contains("cut off"));
    // No topic of events.
    let got = read(&mcap("std_msgs/String", &[vec![0; 4]]));
    assert!(got.error().contains("but /events (std_msgs/String)"), "{got:?}");
}

#[test]
fn a_wrong_checksum_is_seen() {
    let mut bytes = fixture("dvs_none.mcap");
    // The last event of the first message that has any.
    let at = bytes.windows(3).position(|w| w == b"cam").unwrap() + 60;
    bytes[at] ^= 1;
    assert!(read(&bytes).error().contains("checksum"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn nothing_that_is_flipped_makes_it_panic(
        file in 0..6usize,
        flips in prop::collection::vec((any::<prop::sample::Index>(), 0..8u8), 1..6),
    ) {
        let names = ["dvs_none.bag", "dvs_bz2.bag", "dvs_lz4.bag", "dvs_none.mcap", "dvs_zstd.mcap", "packets_evt3.mcap"];
        let mut bytes = fixture(names[file]);
        for (at, bit) in flips {
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
        }
        let got = read(&bytes);
        prop_assert!(got.events.len() <= 20 * events(0).len());
    }
}
