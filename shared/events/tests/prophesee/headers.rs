//! Headers, good and bad.

use super::words::*;
use evpr_core::plan::Sensor;
use evpr_events::ReadOptions;
use evpr_events::formats::prophesee::{Encoding, Evt21Order};

fn with_header(header: &str, data: &[u8]) -> Vec<u8> {
    [header.as_bytes(), data].concat()
}

/// One event of EVT 3.0 at 4097 µs.
fn one_evt3() -> Vec<u8> {
    evt3(&[high(1), low(1), y(2), on(3)])
}

fn sensor(height: usize, width: usize) -> Option<Sensor> {
    Some(Sensor { height, width })
}

#[test]
fn the_sensor_is_as_said_or_as_named() {
    for (header, want) in [
        ("% evt 3.0\n% end\n", None),
        ("% format EVT3;height=720;width=1280\n% end\n", sensor(720, 1280)),
        ("% format EVT3;width=640;height=480\n", sensor(480, 640)),
        ("% evt 3.0\r\n% geometry 640x480\r\n% end\r\n", sensor(480, 640)),
        ("%\n% evt 3.0\n% Width 304\n% Height 240\n%\n", sensor(240, 304)),
        ("% evt 3.0\n% sensor_name IMX636\n% end\n", sensor(720, 1280)),
        (
            "% evt 3.0\n% plugin_name hal_plugin_gen31_evk2\n",
            sensor(480, 640),
        ),
        (
            "% evt 3.0\n% plugin_name hal_plugin_genx320_cx3\n",
            sensor(320, 320),
        ),
        ("% evt 3.0\n% generation 4.1\n% end\n", sensor(720, 1280)),
        (
            "% evt 3.0\n% plugin_name hal_plugin_gen3_fx3\n% geometry 320x240\n",
            sensor(240, 320),
        ),
        ("% evt 3.0\n% plugin_name camera_of_tomorrow\n% end\n", None),
        ("% evt 2.0\n% format EVT3;height=4;width=5\n% end\n", sensor(4, 5)),
    ] {
        let bytes = with_header(header, &one_evt3());
        assert_eq!(open(&bytes, None).unwrap().sensor(), want, "{header}");
        let (events, end) = read(&bytes, None);
        end.unwrap();
        assert_eq!(short(&events), [(4097, 3, 2, true)], "{header}");
    }
}

#[test]
fn after_the_end_of_the_header_words_may_look_like_one() {
    // 0x2025 is `% ` in the file: an event at x 37.
    let data = evt3(&[0x2025, high(1), low(1), y(2), 0x2025]);
    let (events, end) = read(&with_header("% evt 3.0\n% end\n", &data), None);
    end.unwrap();
    assert_eq!(short(&events), [(4097, 37, 2, false)]);
}

#[test]
fn the_order_of_evt21_is_as_said_or_that_of_the_system() {
    let order = |header: &str| {
        let bytes = with_header(header, &evt21(&[0]));
        open(&bytes, None).unwrap().describe().format
    };
    assert_eq!(order("% format EVT21;height=320;width=320\n% end\n"), "EVT2.1");
    assert_eq!(
        order("% format EVT21;endianness=legacy\n% end\n"),
        "EVT2.1 (legacy order)"
    );
    assert_eq!(
        order("% endianness legacy\n% evt 2.1\n% end\n"),
        "EVT2.1 (legacy order)"
    );
    assert_eq!(
        order("% evt 2.1\n% system_ID 49\n% end\n"),
        "EVT2.1 (legacy order)"
    );
    assert_eq!(order("% evt 2.1\n% system_ID 64\n% end\n"), "EVT2.1");
    assert_eq!(
        order("% evt 2.1\n% system_ID 49\n% endianness little\n% end\n"),
        "EVT2.1"
    );
}

#[test]
fn dat_is_read_from_its_header_on() {
    let header = "% Data file containing CD events\n% Version 2\n% Width 304\n% Height 240\n";
    for kind in [0_u8, 12] {
        let data = [&[kind, 8][..], &dat(7, 1, 2, 1), &dat(9, 3, 4, 0)].concat();
        let bytes = with_header(header, &data);
        let recording = open(&bytes, None).unwrap();
        assert_eq!(recording.sensor(), sensor(240, 304));
        assert_eq!(recording.describe().format, "DAT");
        let (events, end) = read(&bytes, None);
        end.unwrap();
        assert_eq!(short(&events), [(7, 1, 2, true), (9, 3, 4, false)]);
    }
}

#[test]
fn what_is_wrong_with_a_header_is_said_in_one_line() {
    let long = format!("% evt 3.0\n% x {}\n% end\n", "x".repeat(5000));
    let many = "% a line of a header that never comes to its end\n".repeat(2000);
    let dat = "% Data file containing CD events\n";
    let dat = |rest: &str| format!("{dat}{rest}");
    for (header, wanted) in [
        ("% end\n", "says the encoding"),
        ("% evt 4.0\n% end\n", "EVT version \"4.0\""),
        (
            "% format HISTO3D;height=320;width=320\n% end\n",
            "holds \"HISTO3D\"",
        ),
        ("% format EVT21;endianness=big\n% end\n", "order \"big\""),
        ("% evt 3.0\n% geometry 640\n% end\n", "geometry \"640\""),
        ("% evt 3.0\n% geometry 0x480\n% end\n", "width \"0\""),
        ("% evt 3.0\n% geometry 640x99999\n% end\n", "height \"99999\""),
        (
            "% format EVT3;width=1280\n% geometry 640x480\n",
            "two values of the sensor's width, 1280 and 640",
        ),
        (&long, "more than 4096 bytes"),
        (&many, "more than 64 KiB"),
        (&dat("% Version 1\n"), "DAT of version \"1\""),
        (
            &dat("\u{e}\u{8}01234567"),
            "holds data of type 14 with 8 bytes each",
        ),
        (
            &dat("\u{0}\u{9}01234567"),
            "holds data of type 0 with 9 bytes each",
        ),
        (&dat(""), "holds no events"),
        (&dat("\u{0}\u{8}"), "holds no events"),
        ("% evt 3.0", "holds no events"),
        ("% evt 3.0\n% end\n", "holds no events"),
        ("%", "says the encoding"),
    ] {
        let mut bytes = header.as_bytes().to_vec();
        if !wanted.contains("no events") {
            bytes.extend(one_evt3());
        }
        if header == "%" {
            bytes.truncate(1);
        }
        let (events, end) = read(&bytes, None);
        let error = end.unwrap_err().to_string();
        assert!(events.is_empty(), "{header}");
        assert!(
            error.contains(wanted) && error.starts_with("piped: "),
            "{header}: {error}"
        );
        assert!(!error.contains('\n'), "{error}");
    }
}

#[test]
fn bare_words_are_read_when_their_encoding_is_said() {
    let bytes = one_evt3();
    assert!(open(&bytes, None).is_err());
    let (events, end) = read(&bytes, Some(Encoding::Evt3));
    end.unwrap();
    assert_eq!(short(&events), [(4097, 3, 2, true)]);
    // Words that begin like a header are words.
    let bytes = evt3(&[0x2025, 0x2025, high(1), low(1), y(2), on(3)]);
    assert_eq!(read(&bytes, Some(Encoding::Evt3)).0.len(), 1);
    // A header is read, and must agree.
    let bytes = with_header("% format EVT3;height=4;width=5\n% end\n", &one_evt3());
    assert_eq!(open(&bytes, Some(Encoding::Evt3)).unwrap().sensor(), sensor(4, 5));
    assert_eq!(read(&bytes, Some(Encoding::Evt3)).0.len(), 1);
    let error = open(&bytes, Some(Encoding::Evt2)).err().unwrap().to_string();
    assert!(
        error.contains("says evt3, but it was to be read as evt2"),
        "{error}"
    );
    // DAT without its lines still has its two bytes.
    let bytes = [&[0, 8][..], &dat(7, 1, 2, 1)].concat();
    assert_eq!(short(&read(&bytes, Some(Encoding::Dat)).0), [(7, 1, 2, true)]);
    for encoding in Encoding::ALL {
        assert_eq!(Encoding::from_name(encoding.name()), Some(encoding));
        let error = open(&[], Some(encoding)).err().unwrap().to_string();
        assert!(error.contains("is empty (0 bytes)"), "{error}");
    }
    assert_eq!(Encoding::from_name("evt4"), None);
    assert_eq!(
        Encoding::from_name("evt21"),
        Some(Encoding::Evt21(Evt21Order::Little))
    );
}

#[test]
fn a_file_is_known_by_its_content() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("camera.bin");
    std::fs::write(&path, with_header("% evt 3.0\n% end\n", &one_evt3())).unwrap();
    let opened = evpr_events::open(&path, &ReadOptions::default()).unwrap();
    assert_eq!(opened.describe().path, path);
    // By its ending alone it is not.
    let path = dir.path().join("camera.raw");
    std::fs::write(&path, one_evt3()).unwrap();
    let error = evpr_events::open(&path, &ReadOptions::default()).err().unwrap();
    assert!(error.to_string().contains("not its header"), "{error}");
}
