//! A depth camera made of software. It speaks USB/IP (kernel documentation `usbip_protocol`) to
//! the kernel's virtual host controller, so the stock `uvcvideo` driver binds to it and shows a
//! real `/dev/videoN`. Runs in the test guest; needs the module `vhci-hcd` and root.
//!
//! Options, each with a frame number: `--unplug N`, `--stall N` (3 s), `--pause N` (7 s),
//! `--silent N` (for ever), `--damage N` (error bit), `--cut N` (half a frame); `--d16` (a format
//! Linux does not know); `--log FILE`, which gets a line with the number of each frame that was
//! sent to its end.

mod descriptors;
mod pattern;

use descriptors::{HEADER_BYTES, INTERVALS, SIZES, UNIT, UNIT_BYTES};
use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;
use std::process::exit;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::thread;
use std::time::{Duration, Instant};

const CONTROLLER: &str = "/sys/devices/platform/vhci_hcd.0";
const SUBMIT: u32 = 1;
const UNLINK: u32 = 2;
const SUBMITTED: u32 = 3;
const UNLINKED: u32 = 4;
const HIGH_SPEED: u32 = 3;
const CONNECTION_RESET: i32 = -104;
const STALLED: i32 = -32;

/// Frame numbers at which something goes wrong.
#[derive(Clone, Copy, Default)]
struct Faults {
    unplug: Option<u32>,
    stall: Option<u32>,
    pause: Option<u32>,
    silent: Option<u32>,
    damage: Option<u32>,
    cut: Option<u32>,
    d16: bool,
}

/// Time for the host to take what was sent before the cable is pulled.
const IN_FLIGHT: Duration = Duration::from_millis(500);

/// A transfer the host waits for.
struct Transfer {
    number: u32,
    bytes: usize,
}

struct Stream {
    waiting: VecDeque<Transfer>,
    /// Number of the size, from 1.
    size: u8,
    interval: u32,
    /// Grows when the host takes transfers back: a frame begun before is given up.
    generation: u64,
    closed: bool,
}

struct Camera {
    faults: Faults,
    /// Frames sent to their end.
    log: Option<File>,
    /// The stall is over.
    rested: AtomicBool,
    host: Mutex<UnixStream>,
    stream: Mutex<Stream>,
    changed: Condvar,
}

impl Camera {
    /// Answers a transfer or an unlink; a closed connection is noticed by the reader.
    fn reply(&self, kind: u32, number: u32, status: i32, length: usize, data: &[u8]) {
        let mut message = Vec::with_capacity(48 + data.len());
        let words = [
            kind,
            number,
            0,
            0,
            0,
            status as u32,
            length as u32,
            0,
            0,
            0,
            0,
            0,
        ];
        message.extend(words.iter().flat_map(|w| w.to_be_bytes()));
        message.extend(data);
        let _ = self.host.lock().unwrap().write_all(&message);
    }

    /// Sends frames as long as the host asks for them.
    fn send_frames(&self) {
        let mut toggle = 0;
        let mut due = Instant::now();
        for number in 0.. {
            loop {
                let (size, interval, generation) = {
                    let idle = |s: &mut Stream| s.waiting.is_empty() && !s.closed;
                    let stream = self.stream.lock().unwrap();
                    let stream = self.changed.wait_while(stream, idle).unwrap();
                    if stream.closed {
                        return;
                    }
                    (
                        SIZES[usize::from(stream.size) - 1],
                        stream.interval,
                        stream.generation,
                    )
                };
                let period = Duration::from_nanos(u64::from(interval) * 100);
                due = due.max(Instant::now() - period * 2) + period;
                thread::sleep(due.saturating_duration_since(Instant::now()));
                if self.send_frame(&self.payload(number, size, toggle), generation) {
                    if let Some(mut log) = self.log.as_ref() {
                        writeln!(log, "{number}").expect("the log takes a line");
                    }
                    break;
                }
            }
            toggle ^= 1;
        }
    }

    /// Header and pixels of a frame, with what the faults do to it.
    fn payload(&self, number: u32, (width, height): (u16, u16), toggle: u8) -> Vec<u8> {
        let at = |fault: Option<u32>| fault == Some(number);
        for (fault, seconds) in [(self.faults.stall, 3), (self.faults.pause, 7)] {
            if at(fault) && !self.rested.swap(true, Ordering::Relaxed) {
                println!("camera: stalls {seconds} s at frame {number}");
                thread::sleep(Duration::from_secs(seconds));
            }
        }
        if at(self.faults.silent) {
            println!("camera: silent from frame {number}");
            loop {
                thread::sleep(Duration::from_secs(3600));
            }
        }
        if at(self.faults.unplug) {
            println!("camera: unplugged at frame {number}");
            thread::sleep(IN_FLIGHT);
            let _ = fs::write(format!("{CONTROLLER}/detach"), "0");
            exit(0);
        }
        let error = if at(self.faults.damage) { 0x40 } else { 0 };
        // End of header, end of frame, and the bit that changes with each frame.
        let mut payload = vec![HEADER_BYTES as u8, 0x80 | 0x02 | error | toggle];
        for y in 0..u32::from(height) {
            for x in 0..u32::from(width) {
                payload.extend(pattern::depth(number, x, y).to_le_bytes());
            }
        }
        if at(self.faults.cut) {
            payload.truncate(payload.len() / 2 + 1);
        }
        payload
    }

    /// Fills the host's transfers with a payload. False when the host took them back.
    fn send_frame(&self, payload: &[u8], generation: u64) -> bool {
        let mut rest = payload;
        while !rest.is_empty() {
            let transfer = {
                let idle = |s: &mut Stream| {
                    s.waiting.is_empty() && s.generation == generation && !s.closed
                };
                let stream = self.stream.lock().unwrap();
                let mut stream = self.changed.wait_while(stream, idle).unwrap();
                if stream.closed || stream.generation != generation {
                    return false;
                }
                stream.waiting.pop_front().unwrap()
            };
            let (now, later) = rest.split_at(transfer.bytes.min(rest.len()));
            self.reply(SUBMITTED, transfer.number, 0, now.len(), now);
            rest = later;
        }
        true
    }

    fn unlink(&self, number: u32, target: u32) {
        let mut stream = self.stream.lock().unwrap();
        let before = stream.waiting.len();
        stream.waiting.retain(|t| t.number != target);
        let found = stream.waiting.len() != before;
        stream.generation += 1;
        drop(stream);
        self.changed.notify_all();
        self.reply(
            UNLINKED,
            number,
            if found { CONNECTION_RESET } else { 0 },
            0,
            &[],
        );
    }

    fn close(&self) {
        self.stream.lock().unwrap().closed = true;
        self.changed.notify_all();
    }
}

/// What endpoint 0 remembers between requests.
struct Control {
    probe: Vec<u8>,
    calibration: Vec<u8>,
}

impl Control {
    /// Answers a control request; `None` stalls it.
    fn answer(&mut self, camera: &Camera, setup: [u8; 8], sent: &[u8]) -> Option<Vec<u8>> {
        let [kind, request, low, high, interface, entity, ..] = setup;
        match (kind, request) {
            (0x80, 6) => match high {
                1 => Some(descriptors::device()),
                2 => Some(descriptors::configuration(camera.faults.d16)),
                3 => Some(descriptors::string(low)),
                6 => Some(descriptors::qualifier()),
                _ => None,
            },
            (0x80..=0x82, 0) => Some(vec![0, 0]), // status
            (0x80, 8) => Some(vec![1]),           // configuration
            (0x81, 10) => Some(vec![0]),          // alternate setting
            (0x00..=0x02, _) => Some(Vec::new()), // set anything standard
            (0x21 | 0xa1, _) if interface == 1 => self.streaming(camera, request, high, sent),
            (0x21 | 0xa1, _) if entity == UNIT && high == 1 => self.unit(request, sent),
            _ => None,
        }
    }

    /// Probe (1) and commit (2).
    fn streaming(
        &mut self,
        camera: &Camera,
        request: u8,
        which: u8,
        sent: &[u8],
    ) -> Option<Vec<u8>> {
        match request {
            0x01 => {
                let size = (*sent.get(3)?).clamp(1, SIZES.len() as u8);
                let asked = u32::from_le_bytes(sent.get(4..8)?.try_into().ok()?);
                let interval = INTERVALS.into_iter().min_by_key(|i| i.abs_diff(asked))?;
                self.probe = descriptors::probe(size, interval);
                if which == 2 {
                    let mut stream = camera.stream.lock().unwrap();
                    (stream.size, stream.interval) = (size, interval);
                }
                Some(Vec::new())
            }
            0x85 => Some(vec![34, 0]),
            0x86 => Some(vec![3]),
            0x81..=0x87 => Some(self.probe.clone()),
            _ => None,
        }
    }

    fn unit(&mut self, request: u8, sent: &[u8]) -> Option<Vec<u8>> {
        match request {
            0x01 => {
                self.calibration = descriptors::calibration(sent);
                Some(Vec::new())
            }
            0x81 => Some(self.calibration.clone()),
            0x85 => Some((UNIT_BYTES as u16).to_le_bytes().to_vec()),
            0x86 => Some(vec![3]),
            _ => None,
        }
    }
}

fn options() -> (Faults, Option<File>) {
    let mut faults = Faults::default();
    let mut log = None;
    let mut arguments = std::env::args().skip(1);
    while let Some(option) = arguments.next() {
        if option == "--d16" {
            faults.d16 = true;
            continue;
        }
        let value = arguments.next();
        if option == "--log" {
            let path = value.expect("--log needs a file");
            log = Some(File::create(path).expect("the log can be written"));
            continue;
        }
        let number = value.and_then(|n| n.parse().ok());
        let number = Some(number.unwrap_or_else(|| panic!("{option} needs a frame number")));
        match option.as_str() {
            "--unplug" => faults.unplug = number,
            "--stall" => faults.stall = number,
            "--pause" => faults.pause = number,
            "--silent" => faults.silent = number,
            "--damage" => faults.damage = number,
            "--cut" => faults.cut = number,
            _ => panic!("unknown option {option}"),
        }
    }
    (faults, log)
}

fn main() {
    let (host, kernel) = UnixStream::pair().expect("a socket pair");
    // Port 0, our end of the pair, device 1 on bus 1, speed.
    let attach = format!("0 {} 65537 {HIGH_SPEED}", kernel.as_raw_fd());
    fs::write(format!("{CONTROLLER}/attach"), attach).expect("vhci-hcd is loaded, port 0 free");
    drop(kernel);
    let mut from_host = host.try_clone().expect("a second handle");
    let (faults, log) = options();
    let camera = Arc::new(Camera {
        faults,
        log,
        rested: AtomicBool::new(false),
        host: Mutex::new(host),
        stream: Mutex::new(Stream {
            waiting: VecDeque::new(),
            size: 1,
            interval: INTERVALS[0],
            generation: 0,
            closed: false,
        }),
        changed: Condvar::new(),
    });
    let sender = camera.clone();
    thread::spawn(move || sender.send_frames());
    let mut control = Control {
        probe: descriptors::probe(1, INTERVALS[0]),
        calibration: vec![0; UNIT_BYTES],
    };
    let mut header = [0; 48];
    while from_host.read_exact(&mut header).is_ok() {
        let word = |i: usize| u32::from_be_bytes(header[i * 4..i * 4 + 4].try_into().unwrap());
        let (number, to_us, endpoint, length) = (word(1), word(3) == 0, word(4), word(6) as usize);
        match word(0) {
            UNLINK => camera.unlink(number, word(5)),
            SUBMIT if endpoint == 1 => {
                let transfer = Transfer {
                    number,
                    bytes: length,
                };
                camera.stream.lock().unwrap().waiting.push_back(transfer);
                camera.changed.notify_all();
            }
            SUBMIT => {
                let mut sent = vec![0; if to_us { length } else { 0 }];
                if from_host.read_exact(&mut sent).is_err() {
                    break;
                }
                let setup = header[40..48].try_into().unwrap();
                match control.answer(&camera, setup, &sent) {
                    None => camera.reply(SUBMITTED, number, STALLED, 0, &[]),
                    Some(_) if to_us => camera.reply(SUBMITTED, number, 0, sent.len(), &[]),
                    Some(mut data) => {
                        data.truncate(length);
                        camera.reply(SUBMITTED, number, 0, data.len(), &data);
                    }
                }
            }
            other => panic!("unknown USB/IP command {other}"),
        }
    }
    camera.close();
}
