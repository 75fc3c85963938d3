//! The oscilloscope: settings, triggering and the download, judged by a decoder written from the
//! description of the format.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use instruments::mock::MockOptions;

use crate::mocks_plant::{AMPLITUDE_V, Bench, FREQ_HZ, volts};

const MODEL: &str = "siglent-sds800x-hd";

/// Takes a block `#9nnnnnnnnn…` with two line feeds apart.
fn payload(reply: &[u8]) -> Vec<u8> {
    assert_eq!(&reply[..2], b"#9");
    let length: usize = std::str::from_utf8(&reply[2..11]).unwrap().parse().unwrap();
    assert_eq!(reply.len(), 11 + length + 2);
    assert_eq!(&reply[11 + length..], b"\n\n");
    reply[11..11 + length].to_vec()
}

fn int16(bytes: &[u8], at: usize) -> i16 {
    i16::from_le_bytes(bytes[at..at + 2].try_into().unwrap())
}

fn int32(bytes: &[u8], at: usize) -> i32 {
    i32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
}

fn single(bytes: &[u8], at: usize) -> f64 {
    f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()).into()
}

fn double(bytes: &[u8], at: usize) -> f64 {
    f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
}

/// Ranged on channel 4, a cell's tap, and triggered on it: five periods on the screen.
fn armed() -> Bench {
    let mut bench = Bench::new(MODEL);
    bench.send(&[
        ":FORMat:DATA DOUBle",
        ":CHANnel1:SWITch ON",
        ":CHANnel4:SWITch ON",
        ":CHANnel4:SCALe 0.05",
        ":CHANnel4:OFFSet -3.8",
        ":TIMebase:SCALe 0.05",
        ":ACQuire:MDEPth 100k",
        ":TRIGger:TYPE EDGE",
        ":TRIGger:EDGE:SOURce C4",
        ":TRIGger:EDGE:SLOPe RISing",
        ":TRIGger:EDGE:LEVel 3.8",
        ":TRIGger:MODE NORMal",
    ]);
    bench.now_s = 1.0;
    bench.send(&[":TRIGger:RUN"]);
    bench
}

fn stopped() -> Bench {
    let mut bench = armed();
    bench.now_s = 3.03;
    bench.send(&[
        ":TRIGger:STOP",
        ":WAVeform:SOURce C4",
        ":WAVeform:STARt 0",
        ":WAVeform:POINt 0",
        ":WAVeform:INTerval 1",
        ":WAVeform:WIDTh WORD",
    ]);
    bench
}

#[test]
fn settings_read_back_in_the_instruments_own_form() {
    let mut bench = Bench::new(MODEL);
    bench.table(&[
        (
            "*IDN?",
            "Siglent Technologies,SDS824X HD,TEST1,4.8.12.1.1.6.5\n",
        ),
        (":CHANnel1:SCALe 5.00E-02", ""),
        (":CHANnel1:SCALe?", "5.00E-02\n"),
        (":CHAN1:SCAL 0.0123456", ""),
        (":CHAN1:SCAL?", "1.23E-02\n"),
        (":FORMat:DATA SINGle", ""),
        (":CHAN1:SCAL?", "1.234560E-02\n"),
        (":FORMat:DATA DOUBle", ""),
        (":CHAN1:SCAL?", "1.2345600000000E-02\n"),
        (":FORMat:DATA CUSTom,4;DATA?", "CUSTom,4\n"),
        (":CHAN1:SCAL?", "1.235E-02\n"),
        (":CHAN1:SCAL 100 mV", ""),
        (":CHAN1:SCAL?", "1.000E-01\n"),
        (":CHAN2:SWIT ON", ""),
        (":CHAN2:SWIT?", "ON\n"),
        (":CHAN2:BWL 20M", ""),
        (":CHAN2:BWL?", "20M\n"),
        (":CHAN2:BWL 200M", ""), // above this model's bandwidth
        (":CHAN2:BWL?", "20M\n"),
        (":CHAN2:IMP FIFT", ""),
        (":CHAN2:IMP?", "ONEMeg\n"),
        (":CHAN2:COUP?", "DC\n"),
        (":CHAN2:PROB VAL,10", ""),
        (":CHAN2:PROB?", "1.000E+01\n"),
        (":CHAN2:SCAL?", "1.000E+01\n"),
        (":TIM:SCAL 3e-3;SCAL?", "2.000E-03\n"),
        (":TIM:REF POS;REF?;REF:POS 20;POS?", "POSition;20\n"),
        (":ACQ:MDEP 1M;MDEP?", "1M\n"),
        (":ACQ:POIN?;SRAT?", "1.000E+06;5.000E+07\n"),
        (":TRIG:MODE SINGle;MODE?", "SINGle\n"),
        (":WAV:MAXP?", "10000000\n"),
        (":WAV:WIDT BYTE;WIDT?", "BYTE\n"),
    ]);
}

#[test]
fn the_offset_is_clamped_to_what_the_scale_allows() {
    let mut bench = Bench::new(MODEL);
    for (scale, offset, read_back) in [
        ("0.0005", "-3.8", "-1.60E+00"),
        ("0.005", "-3.8", "-1.60E+00"),
        ("0.0051", "-3.8", "-3.80E+00"),
        ("0.08", "-3.8", "-3.80E+00"),
        ("0.08", "-30", "-1.60E+01"),
        ("0.0001", "0", "0.00E+00"),
    ] {
        bench.send(&[
            &format!(":CHAN1:SCAL {scale}"),
            &format!(":CHAN1:OFFS {offset}"),
        ]);
        assert_eq!(
            bench.ask(":CHAN1:OFFS?"),
            format!("{read_back}\n"),
            "{offset} V at {scale} V/div"
        );
    }
    assert_eq!(bench.ask(":CHAN1:SCAL?"), "5.00E-04\n");
    // A finer scale takes back an offset that it does not allow.
    bench.send(&[":CHAN1:SCAL 0.1", ":CHAN1:OFFS -3.8", ":CHAN1:SCAL 0.002"]);
    assert_eq!(bench.ask(":CHAN1:OFFS?"), "-1.60E+00\n");
    // At 1 V/div, the level may lie 4.1 divisions from the centre.
    bench.send(&[":CHAN1:SCAL 1", ":CHAN1:OFFS -1", ":TRIG:EDGE:LEV 9"]);
    assert_eq!(bench.ask(":TRIG:EDGE:LEV?"), "5.10E+00\n");
}

#[test]
fn errors_are_silent_but_queued() {
    let mut bench = Bench::new(MODEL);
    bench.table(&[
        (":NONSENSE?", ""),
        ("SYST:ERR?", "-101,\"Invalid character\"\n"),
        (":TRIG:RUN?", ""),
        ("SYST:ERR?", "-113,\"Undefined header\"\n"),
        (":CHAN1:SCAL", ""),
        ("SYST:ERR?", "-200,\"Execution error\"\n"),
        (":TRIGger:FORCe", ""),
        (":WAV:PRE?;:NONSENSE?", ""),
        ("*CLS", ""),
        ("SYST:ERR?", "0,\"No error\"\n"),
    ]);
}

#[test]
fn a_download_gives_back_the_volts_of_the_world() {
    let mut bench = stopped();
    let descriptor = payload(&bench.bytes(":WAVeform:PREamble?"));
    assert_eq!(
        (descriptor.len(), &descriptor[..9]),
        (346, &b"WAVEDESC\0"[..])
    );
    assert_eq!(
        (
            int16(&descriptor, 32),
            int16(&descriptor, 34),
            int32(&descriptor, 36)
        ),
        (1, 0, 346)
    );
    assert_eq!(
        (
            int32(&descriptor, 60),
            int32(&descriptor, 116),
            int32(&descriptor, 136)
        ),
        (200_000, 100_000, 1)
    );
    assert_eq!((int16(&descriptor, 172), int16(&descriptor, 344)), (16, 3));
    let (scale, offset, per_div) = (
        single(&descriptor, 156),
        single(&descriptor, 160),
        single(&descriptor, 164),
    );
    let (interval_s, delay_s, probe) = (
        single(&descriptor, 176),
        double(&descriptor, 180),
        single(&descriptor, 328),
    );
    assert_eq!((per_div, probe), (7680.0, 1.0));
    assert!((interval_s / 5e-6 - 1.0).abs() < 1e-6);
    let samples = payload(&bench.bytes(":WAVeform:DATA?"));
    assert_eq!(samples.len(), 200_000);
    // Stopped at 3.03 s, half a screen is 0.25 s: the last rising crossing with a whole screen
    // around it was at 2.7 s.
    let trigger_s = 2.7;
    let time_scale: f64 = bench.ask(":TIM:SCAL?").trim().parse().unwrap();
    for index in (0..100_000).step_by(777) {
        let code = int16(&samples, 2 * index);
        assert_eq!(code % 16, 0, "12 bits, left-justified");
        let measured = (f64::from(code) * scale / per_div - offset) * probe;
        let t_s = trigger_s + delay_s - 5.0 * time_scale + index as f64 * interval_s;
        // Half an ADC step, and the single precision of offset and interval.
        assert!(
            (measured - volts(4, t_s)).abs() < 0.5 * 0.05 / 480.0 + 5e-6,
            "sample {index}: {measured} V, expected {} V",
            volts(4, t_s)
        );
    }
}

#[test]
fn bytes_are_the_high_halves_of_the_words() {
    let mut bench = stopped();
    let words = payload(&bench.bytes(":WAVeform:DATA?"));
    bench.send(&[":WAVeform:BYTeorder MSB"]);
    let swapped = payload(&bench.bytes(":WAVeform:DATA?"));
    bench.send(&[":WAVeform:WIDTh BYTE"]);
    let bytes = payload(&bench.bytes(":WAVeform:DATA?"));
    for index in (0..100_000).step_by(1013) {
        assert_eq!(bytes[index], words[2 * index + 1]);
        assert_eq!(
            (swapped[2 * index], swapped[2 * index + 1]),
            (words[2 * index + 1], words[2 * index])
        );
    }
    assert_eq!(
        single(&payload(&bench.bytes(":WAVeform:PREamble?")), 164),
        7680.0
    );
}

#[test]
fn pages_and_strides_are_pieces_of_the_whole() {
    let mut bench = stopped();
    let whole = payload(&bench.bytes(":WAVeform:DATA?"));
    bench.send(&[":WAVeform:STARt 99000", ":WAVeform:POINt 500"]);
    assert_eq!(
        payload(&bench.bytes(":WAVeform:DATA?")),
        whole[198_000..199_000]
    );
    bench.send(&[
        ":WAVeform:STARt 0",
        ":WAVeform:POINt 0",
        ":WAVeform:INTerval 7",
    ]);
    let strided = payload(&bench.bytes(":WAVeform:DATA?"));
    let expected: Vec<u8> = whole
        .chunks(14)
        .flat_map(|chunk| chunk[..2].to_vec())
        .collect();
    assert_eq!(strided, expected);
    assert_eq!(
        int32(&payload(&bench.bytes(":WAVeform:PREamble?")), 116),
        100_000
    );
    // Another client finds the stride that this one has left.
    assert_eq!(bench.ask(":WAVeform:INTerval?"), "7\n");
    // The world was queried for no more samples than were sent.
    let asked: usize = bench
        .plant
        .lock()
        .unwrap()
        .requests
        .iter()
        .map(|request| request.count)
        .sum();
    assert_eq!(asked, 100_000 + 500 + 14_286);
}

#[test]
fn a_small_memory_comes_in_pages() {
    let mut bench = Bench::with(MODEL, &MockOptions::quirk("page_points", 3000.0));
    bench.send(&[
        ":TIM:SCAL 0.01",
        ":ACQ:MDEP 10k",
        ":TRIG:MODE AUTO",
        ":WAV:WIDT WORD",
    ]);
    bench.now_s = 1.0;
    bench.send(&[":TRIG:STOP"]);
    assert_eq!(bench.ask(":WAV:MAXP?"), "3000\n");
    let lengths: Vec<usize> = [0, 3000, 6000, 9000, 12_000]
        .iter()
        .map(|start| {
            bench.send(&[&format!(":WAV:STAR {start}")]);
            payload(&bench.bytes(":WAV:DATA?")).len() / 2
        })
        .collect();
    assert_eq!(lengths, [3000, 3000, 3000, 1000, 0]);
}

#[test]
fn before_the_first_frame_the_descriptor_is_empty() {
    let mut bench = armed();
    bench.send(&[":WAVeform:SOURce C4"]);
    assert_eq!(payload(&bench.bytes(":WAVeform:PREamble?")), vec![0; 346]);
    assert_eq!(payload(&bench.bytes(":WAVeform:DATA?")), Vec::<u8>::new());
    bench.now_s = 2.0;
    assert_eq!(
        &payload(&bench.bytes(":WAVeform:PREamble?"))[..8],
        b"WAVEDESC"
    );
    // A channel that was off has none either.
    bench.send(&[":WAVeform:SOURce C2"]);
    assert_eq!(payload(&bench.bytes(":WAVeform:PREamble?")), vec![0; 346]);
}

#[test]
fn the_status_follows_the_acquisition() {
    let mut bench = armed();
    for (now_s, status) in [
        (1.1, "Arm"),
        (1.3, "Ready"),
        (1.7, "Trig'd"),
        (2.5, "Trig'd"),
    ] {
        bench.now_s = now_s;
        assert_eq!(
            bench.ask(":TRIGger:STATus?"),
            format!("{status}\n"),
            "at {now_s} s"
        );
    }
    bench.table(&[
        ("INR?", "1\n"),
        (":TRIG:STOP", ""),
        (":TRIG:STAT?", "Stop\n"),
    ]);
    bench.table(&[
        (":TRIG:MODE AUTO", ""),
        (":TRIG:STAT?", "Stop\n"),
        (":TRIG:RUN", ""),
        (":TRIG:STAT?", "Roll\n"),
        (":TIM:SCAL 0.01", ""),
        (":TRIG:STAT?", "Auto\n"),
    ]);
}

#[test]
fn a_frame_lies_wholly_between_run_and_stop() {
    let mut bench = stopped();
    let _ = bench.bytes(":WAVeform:DATA?");
    let request = *bench.plant.lock().unwrap().requests.last().unwrap();
    assert!((request.start_s - 2.45).abs() < 1e-9, "{request:?}");
    assert_eq!(request.channel, 4);
    assert!(
        (request.codes_per_volt - 9600.0).abs() < 1e-6 && (request.offset_v + 3.8).abs() < 1e-9,
        "{request:?}"
    );
    assert_eq!((request.code_min, request.code_max), (-2048, 2047));
    // Later settings do not touch a frame that has been taken.
    bench.send(&[":CHANnel4:SCALe 1", ":TIMebase:SCALe 1"]);
    let descriptor = payload(&bench.bytes(":WAVeform:PREamble?"));
    assert!((single(&descriptor, 156) - 0.05).abs() < 1e-7);
    // Too short for a whole frame: none, rather than half a one.
    bench.send(&[":TIMebase:SCALe 0.05", ":TRIGger:RUN"]);
    bench.now_s += 0.3;
    bench.send(&[":TRIGger:STOP"]);
    assert_eq!(payload(&bench.bytes(":WAVeform:PREamble?")), vec![0; 346]);
}

#[test]
fn acquisitions_are_numbered() {
    let mut bench = armed();
    let mut numbers = Vec::new();
    for _ in 0..3 {
        bench.send(&[":WAVeform:SOURce C4", ":TRIGger:RUN"]);
        bench.now_s += 2.0;
        bench.send(&[":TRIGger:STOP"]);
        for source in ["C4", "C1"] {
            bench.send(&[&format!(":WAVeform:SOURce {source}")]);
            let _ = bench.bytes(":WAVeform:DATA?");
            numbers.push(
                bench
                    .plant
                    .lock()
                    .unwrap()
                    .requests
                    .last()
                    .unwrap()
                    .acquisition,
            );
        }
    }
    assert!(
        numbers.chunks(2).all(|pair| pair[0] == pair[1]),
        "channels of one frame share its number: {numbers:?}"
    );
    assert!(
        numbers[0] < numbers[2] && numbers[2] < numbers[4],
        "{numbers:?}"
    );
}

#[test]
fn normal_waits_for_a_trigger_and_auto_does_not() {
    let mut bench = armed();
    bench.plant.lock().unwrap().silent_from_s = 0.5;
    bench.now_s = 5.0;
    bench.table(&[(":TRIG:STAT?", "Ready\n"), (":WAV:SOUR C4", "")]);
    assert_eq!(payload(&bench.bytes(":WAV:PRE?")), vec![0; 346]);
    bench.send(&[":TRIG:MODE FTRIG"]);
    bench.now_s = 5.3;
    assert_eq!(&payload(&bench.bytes(":WAV:PRE?"))[..8], b"WAVEDESC");
    bench.send(&[":TRIG:MODE AUTO"]);
    bench.now_s = 6.0;
    assert_eq!(&payload(&bench.bytes(":WAV:PRE?"))[..8], b"WAVEDESC");
}

#[test]
fn single_stops_at_the_first_trigger() {
    let mut bench = armed();
    bench.send(&[":TRIG:EDGE:SLOP FALL", ":TRIG:MODE SING"]);
    bench.now_s = 9.0;
    bench.table(&[(":TRIG:STAT?", "Stop\n"), (":WAV:SOUR C4", "")]);
    let _ = bench.bytes(":WAV:DATA?");
    let start_s = bench.plant.lock().unwrap().requests.last().unwrap().start_s;
    // Armed at 1 s, half a screen of 0.25 s: the first falling crossing from 1.25 s on.
    assert!((start_s - (1.25 - 0.25)).abs() < 1e-9, "{start_s}");
}

#[test]
fn delay_and_reference_move_the_screen() {
    let mut bench = armed();
    bench.send(&[":TIM:REF:POS 10", ":TIM:DEL 0.02", ":TRIG:RUN"]);
    bench.now_s = 3.0;
    bench.send(&[":TRIG:STOP", ":WAV:SOUR C4", ":WAV:WIDT WORD"]);
    let descriptor = payload(&bench.bytes(":WAV:PRE?"));
    // First sample 0.03 s before the trigger, the screen 0.5 s wide: its centre is 0.22 s behind
    // the trigger.
    assert!((double(&descriptor, 180) - 0.22).abs() < 1e-12);
    let _ = bench.bytes(":WAV:DATA?");
    let start_s = bench.plant.lock().unwrap().requests.last().unwrap().start_s;
    assert!(
        ((start_s + 0.03) * FREQ_HZ - ((start_s + 0.03) * FREQ_HZ).round()).abs() < 1e-6,
        "{start_s}"
    );
}

#[test]
fn an_overdriven_channel_clips_beyond_the_screen() {
    let mut bench = stopped();
    bench.send(&[":CHANnel4:SCALe 0.01", ":CHANnel4:OFFSet -3.8", ":TRIG:RUN"]);
    bench.now_s += 2.0;
    bench.send(&[":TRIG:STOP"]);
    let samples = payload(&bench.bytes(":WAV:DATA?"));
    let codes: Vec<i16> = samples
        .chunks(2)
        .map(|pair| i16::from_le_bytes([pair[0], pair[1]]))
        .collect();
    assert_eq!(
        (*codes.iter().min().unwrap(), *codes.iter().max().unwrap()),
        (-32768, 32752)
    );
    const {
        assert!(
            AMPLITUDE_V > 4.27 * 0.01,
            "the sine must reach beyond the range"
        );
    };
}
