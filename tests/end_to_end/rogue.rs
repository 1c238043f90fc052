//! Somebody else writes into the channels of a running instance: messages that nobody of the plan can have sent, and
//! sound ones under somebody's name.

use super::support::{Bench, Running, TICKS, assert_ticks, read_answers, run_args, text, timeless};
use evpr_core::message::{
    Candidate, ChunkHeader, Chunks, Control, ControlHeader, DescriptorHeader, Descriptors, FrameHeader,
    Frames, Header, Lifecycle, LifecycleHeader, MatchHeader, Matches, MemberSetting, Message, ServiceHealth,
    ServicePhase, ServiceState, Stamp, Stats, StatsHeader, TickHeader, TickKind, Ticks,
};
use evpr_core::plan::Topic;
use evpr_runtime::{RunFolder, RunSpec};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use serde_json::Value;
use std::any::Any;
use std::cell::RefCell;
use std::collections::HashMap;

type Ipc = ipc_threadsafe::Service;

/// A publisher does not keep its service alive by itself.
type Port<M> = (
    Publisher<Ipc, [<M as Message>::Item], <M as Message>::Header>,
    PortFactory<Ipc, [<M as Message>::Item], <M as Message>::Header>,
);

struct Rogue {
    spec: RunSpec,
    /// By channel. They stay: what a port has sent that is gone is read by nobody who had not seen it.
    ports: RefCell<HashMap<String, Box<dyn Any>>>,
    // Goes last.
    node: Node<Ipc>,
}

impl Rogue {
    fn join(bench: &Bench) -> Self {
        let folder = bench.run_folder();
        let mut config = Config::default();
        config.global.prefix = FileName::new(bench.shm_prefix().as_bytes()).unwrap();
        let root = folder.join("ipc");
        let root = Path::new(root.as_os_str().as_encoded_bytes()).unwrap();
        config.global.set_root_path(&root);
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled);
        Self {
            spec: RunFolder::at(folder).read_spec().unwrap(),
            ports: RefCell::default(),
            node: node.create::<Ipc>().unwrap(),
        }
    }

    fn index(&self, name: &str) -> u32 {
        let services = self.spec.plan.services();
        services.iter().position(|s| s.name == name).unwrap() as u32
    }

    fn publisher<M: Message>(&self, topic: &Topic) -> Port<M> {
        let channel = self.spec.plan.channel(topic).unwrap();
        let name = ServiceName::new(&topic.to_string()).unwrap();
        let service = self
            .node
            .service_builder(&name)
            .publish_subscribe::<[M::Item]>()
            .user_header::<M::Header>()
            .payload_alignment(Alignment::new(64).unwrap())
            .open()
            .unwrap();
        let builder = service
            .publisher_builder()
            .initial_max_slice_len(channel.max_items.max(1))
            .allocation_strategy(AllocationStrategy::Static)
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData);
        (builder.create().unwrap(), service)
    }

    /// Sends a message with a stamp of this run by a port of its own, as service `service`.
    fn send<M: Message>(
        &self,
        topic: &Topic,
        service: u32,
        seq: u64,
        mut header: M::Header,
        payload: &[M::Item],
    ) {
        let mut ports = self.ports.borrow_mut();
        let port = ports
            .entry(topic.to_string())
            .or_insert_with(|| Box::new(self.publisher::<M>(topic)));
        let (publisher, _) = port.downcast_ref::<Port<M>>().unwrap();
        let mut sample = publisher.loan_slice(payload.len().max(1)).unwrap();
        sample.payload_mut()[..payload.len()].copy_from_slice(payload);
        *header.stamp_mut() = Stamp {
            run_id: self.spec.run_id,
            seq,
            sent_ns: evpr_runtime::now_ns(),
            service,
            incarnation: 1,
            items: payload.len() as u32,
            _pad: 0,
        };
        *sample.user_header_mut() = header;
        sample.send().unwrap();
    }

    /// One message into every channel that could end or bend the run if it were believed.
    fn pretend(&self, seq: u64) {
        let plan = &self.spec.plan;
        let members = plan.members.len();
        let end = TickHeader {
            tick: 3,
            kind: TickKind::End as u32,
            ..TickHeader::default()
        };
        self.send::<Ticks>(&Topic::Ticks, 0, seq, end, &[]);
        let chunk = ChunkHeader {
            tick: 50,
            closes: 1,
            ..ChunkHeader::default()
        };
        self.send::<Chunks>(&Topic::Events, 0, seq, chunk, &[]);
        let (count, pixels) = (
            self.index("reconstruct/event_count"),
            plan.sensor.pixels() * plan.reconstructions[0].channels,
        );
        let frame = FrameHeader {
            tick: 50,
            height: plan.sensor.height as u32,
            width: plan.sensor.width as u32,
            channel_order: 1,
            extractors: u32::MAX,
            ..FrameHeader::default()
        };
        self.send::<Frames>(
            &Topic::Frames("event_count".to_owned()),
            count,
            seq,
            frame,
            &vec![9; pixels],
        );
        let extract = self.index("extract/patch_norm");
        let dim = plan.extractors[0].dim;
        let row = DescriptorHeader {
            tick: 50,
            dim: dim as u32,
            reconstruct_service: count,
            reconstruct_incarnation: 1,
            ..DescriptorHeader::default()
        };
        let rows = Topic::Descriptors("patch_norm".to_owned());
        self.send::<Descriptors>(&rows, extract, seq, row, &vec![1.0; dim]);
        let answer = MatchHeader {
            tick: 1 << 40,
            reference: 3,
            candidates: 1,
            ..MatchHeader::default()
        };
        let fuse = self.index("fuse");
        self.send::<Matches>(&Topic::Matches, fuse, seq, answer, &[Candidate::default()]);
        let down = ServiceState {
            dead_through: u32::MAX,
            health: ServiceHealth::Down as u32,
            ..ServiceState::default()
        };
        let lifecycle = LifecycleHeader {
            version: 1 << 40,
            ..LifecycleHeader::default()
        };
        let states = vec![down; plan.services().len()];
        self.send::<Lifecycle>(&Topic::Lifecycle, Stamp::SUPERVISOR, seq, lifecycle, &states);
        let off = vec![MemberSetting::default(); members];
        let control = ControlHeader {
            version: 1 << 40,
            ..ControlHeader::default()
        };
        self.send::<Control>(&Topic::Control, Stamp::SUPERVISOR, seq, control, &off);
        let done = StatsHeader {
            phase: ServicePhase::Done as u32,
            next_tick: 1 << 40,
            ..StatsHeader::default()
        };
        self.send::<Stats>(&Topic::Stats, fuse, seq, done, &[]);
    }

    /// Messages whose sizes, indices and codes are wrong, under the name of a process that there is no more.
    fn babble(&self) {
        let far = u64::MAX;
        let tick = TickHeader {
            tick: far,
            kind: 7,
            ..TickHeader::default()
        };
        self.send::<Ticks>(&Topic::Ticks, 0, far, tick, &[f64::NAN]);
        let chunk = ChunkHeader {
            tick: far,
            segment: u32::MAX,
            closes: u32::MAX,
            flags: u32::MAX,
            ..ChunkHeader::default()
        };
        self.send::<Chunks>(&Topic::Events, 77, far, chunk, &[]);
        let frame = FrameHeader {
            reconstruction: u32::MAX,
            window: u32::MAX,
            height: u32::MAX,
            width: u32::MAX,
            ..FrameHeader::default()
        };
        self.send::<Frames>(&Topic::Frames("time_surface".to_owned()), 1, far, frame, &[1]);
        let row = DescriptorHeader {
            member: u32::MAX,
            dim: u32::MAX,
            ..DescriptorHeader::default()
        };
        let rows = Topic::Descriptors("raw_pixels".to_owned());
        self.send::<Descriptors>(&rows, self.index("extract/raw_pixels"), far, row, &[f32::NAN]);
        let answer = MatchHeader {
            tick: far,
            candidates: u32::MAX,
            ..MatchHeader::default()
        };
        self.send::<Matches>(&Topic::Matches, 0, far, answer, &[Candidate::default()]);
        self.send::<Stats>(&Topic::Stats, u32::MAX, far, StatsHeader::default(), &[]);
        let lifecycle = LifecycleHeader::default();
        self.send::<Lifecycle>(&Topic::Lifecycle, 0, far, lifecycle, &[]);
        self.send::<Control>(&Topic::Control, 0, far, ControlHeader::default(), &[]);
    }
}

#[test]
fn a_rogue_in_every_channel_changes_nothing_and_is_counted() {
    let bench = Bench::new();
    let config = bench.ensemble_config();
    let map = bench.map(&config);
    let query = bench.recording("query.txt", TICKS, 2);
    let out = bench.path("alone.jsonl");
    let said = bench.run(&run_args(&config, &query, &map, &["-o", text(&out)]));
    assert_eq!(said.code(), 0, "{}", said.stderr);
    let alone = read_answers(&out);

    let mut running = Running::start(&bench, &run_args(&config, &query, &map, &["--pace", "5"]));
    assert!(running.read_to(20));
    let rogue = Rogue::join(&bench);
    for seq in [0, 1_000_000] {
        rogue.pretend(seq);
        rogue.babble();
    }
    assert!(running.read_to(150));
    let status: Value = serde_json::from_str(&bench.run(&["status", "--json"]).stdout).unwrap();
    drop(rogue);
    let (answers, said) = running.finish();
    assert_eq!(said.code(), 0, "{}", said.stderr);
    assert_ticks(&answers, TICKS);
    for (a, b) in answers.iter().zip(&alone) {
        assert_eq!(timeless(a), timeless(b), "{}", said.stderr);
    }
    assert!(status["refused"].as_u64().unwrap() >= 4, "{status}");
    for service in status["services"].as_array().unwrap() {
        assert!(service["refused"].as_u64().unwrap() > 0, "{service}");
    }
    assert!(said.stderr.contains("a message is refused"), "{}", said.stderr);
    assert_eq!(bench.left_behind(), Vec::<String>::new());
}
