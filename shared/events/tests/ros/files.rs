//! Bags and MCAP of messages made here, by writers that share nothing with the reader.

/// {u32 length, bytes}.
pub(super) fn block(bytes: &[u8]) -> Vec<u8> {
    [&(bytes.len() as u32).to_le_bytes(), bytes].concat()
}

/// `event_camera_msgs/EventPacket` as ROS 1 lays it out.
pub(super) fn packet(seq: u64, stamp_s: u32, base_ns: u64, encoding: &str, events: &[u8]) -> Vec<u8> {
    let mut m = Vec::new();
    m.extend(0u32.to_le_bytes());
    m.extend(stamp_s.to_le_bytes());
    m.extend(0u32.to_le_bytes());
    m.extend(block(b"frame"));
    m.extend(720u32.to_le_bytes());
    m.extend(1280u32.to_le_bytes());
    m.extend(seq.to_le_bytes());
    m.extend(base_ns.to_le_bytes());
    m.extend(block(encoding.as_bytes()));
    m.push(0);
    m.extend(block(events));
    m
}

/// MCAP without chunks, of one topic in the layout of ROS 1.
pub(super) fn mcap(kind: &str, messages: &[Vec<u8>]) -> Vec<u8> {
    let record = |op: u8, content: &[u8]| {
        let len = content.len() as u64;
        [&[op][..], &len.to_le_bytes(), content].concat()
    };
    let mut file = b"\x89MCAP0\r\n".to_vec();
    file.extend(record(1, &[block(b"ros1"), block(b"")].concat()));
    let schema = [
        7u16.to_le_bytes().to_vec(),
        block(kind.as_bytes()),
        block(b"ros1msg"),
        block(b""),
    ];
    file.extend(record(3, &schema.concat()));
    let channel = [
        3u16.to_le_bytes().to_vec(),
        7u16.to_le_bytes().to_vec(),
        block(b"/events"),
        block(b"ros1"),
        block(b""),
    ];
    file.extend(record(4, &channel.concat()));
    for message in messages {
        let head = [&3u16.to_le_bytes()[..], &[0; 20]].concat();
        file.extend(record(5, &[&head[..], message].concat()));
    }
    file.extend(record(15, &[0; 4]));
    file
}

/// A record of a bag.
pub(super) fn bag_record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    let header: Vec<u8> = fields
        .iter()
        .flat_map(|(name, value)| block(&[name.as_bytes(), b"=", value].concat()))
        .collect();
    [block(&header), block(data)].concat()
}

/// A bag of one topic, each message in a chunk of its own. `closed`: its header says where the index would be.
pub(super) fn bag(kind: &str, messages: &[Vec<u8>], closed: bool) -> Vec<u8> {
    let connection = bag_record(
        &[("op", &[7]), ("conn", &[0; 4]), ("topic", b"/events")],
        &[
            block(b"topic=/other"),
            block(format!("type={kind}").as_bytes()),
            block(b"md5sum=*"),
            block(b"message_definition=a=b"),
        ]
        .concat(),
    );
    let mut chunks = Vec::new();
    for message in messages {
        let message = bag_record(&[("op", &[2]), ("conn", &[0; 4]), ("time", &[0; 8])], message);
        let chunk = [&connection[..], &message].concat();
        let size = (chunk.len() as u32).to_le_bytes();
        chunks.extend(bag_record(
            &[("op", &[5]), ("compression", b"none"), ("size", &size)],
            &chunk,
        ));
        chunks.extend(bag_record(&[("op", &[4]), ("ver", &[1, 0, 0, 0])], &[0; 12]));
    }
    let mut file = b"#ROSBAG V2.0\n".to_vec();
    // The same length with any place of the index.
    let header = |index: u64| bag_record(&[("op", &[3]), ("index_pos", &index.to_le_bytes())], &[b' '; 100]);
    let index_at = (file.len() + header(0).len() + chunks.len()) as u64;
    file.extend(header(if closed { index_at } else { 0 }));
    file.extend(chunks);
    if closed {
        file.extend(connection);
    }
    file
}
