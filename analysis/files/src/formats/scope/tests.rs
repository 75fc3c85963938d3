//! Real files of scopes, and files of other kinds. Provenance: `fixtures/data/captures/README.md`.

use std::path::PathBuf;

use super::*;
use analysis_signal::sine::{Channel, FitOptions, Record, fit_known_frequency};

fn fixture(name: &str) -> PathBuf {
    PathBuf::from(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../fixtures/data/captures"
    ))
    .join(name)
}

fn near(met: f64, expected: f64, within: f64) {
    assert!(
        (met - expected).abs() <= within,
        "{met}, expected {expected}"
    );
}

#[test]
fn a_siglent_of_known_voltage_reads_that_voltage() {
    // 4.5 V, probe 10:1, 0 V far off the screen: a wrong sign of the offset or a forgotten probe
    // would be off by volts.
    let record = open_scope(&fixture("SDS814X-4v5-dc.bin"), None).unwrap();
    assert_eq!(
        (record.kind, record.samples, record.names.as_slice()),
        ("Siglent binary", 10_000, ["C1".to_owned()].as_slice())
    );
    near(record.interval_s, 5.0e-7, 1.0e-15);
    let volts = record.volts(0, 0, 10_000).unwrap();
    near(volts.iter().sum::<f64>() / 10_000.0, 4.522_127, 1.0e-6);
    // Twelve bits in the upper part of sixteen.
    let Some(Channel::Stored(stored)) = record.channel(0) else {
        panic!("no channel")
    };
    assert_eq!(stored.scale.unwrap().code_step, 16);
    let record = open_scope(&fixture("SDS814X-3v0-probe10x.bin"), None).unwrap();
    let mut volts = record.volts(0, 0, 2000).unwrap();
    volts.sort_by(f64::total_cmp);
    near(volts[1500], 2.987_5, 1.0e-6);
}

#[test]
fn a_rigol_binary_gives_its_floats_channel_by_channel() {
    let record = open_scope(&fixture("DHO824-ch12.bin"), None).unwrap();
    assert_eq!((record.kind, record.samples), ("Rigol binary", 10_000));
    assert_eq!(record.names, ["CH1", "CH2"]);
    near(record.interval_s, 4.0e-7, 1.0e-13);
    assert_eq!(
        record.volts(0, 0, 2).unwrap(),
        [
            f64::from(f32::from_le_bytes([0x21, 0x89, 0xde, 0x3d])),
            f64::from(f32::from_le_bytes([0x01, 0x30, 0x1e, 0x3e]))
        ]
    );
    assert!(record.volts(1, 9_999, 1).unwrap()[0].is_finite() && record.channel(2).is_none());
}

#[test]
fn a_lecroy_trace_gives_gain_times_code_less_offset() {
    let record = open_scope(&fixture("lecroy_4.trc"), None).unwrap();
    assert_eq!((record.kind, record.samples), ("LeCroy trace", 502));
    near(record.interval_s, 1.0e-9, 1.0e-15);
    let volts = record.volts(0, 0, 2).unwrap();
    near(volts[0], -0.023_959_04, 1.0e-8);
    near(volts[1], 0.008_039_68, 1.0e-8);
    let message = open_scope(&fixture("lecroy_3.trc"), None)
        .unwrap_err()
        .to_string();
    assert!(
        message.ends_with(
            "lecroy_3.trc: LeCroy trace, segments: expected one record, met a sequence of 20"
        ),
        "{message}"
    );
}

#[test]
fn a_rigol_table_takes_its_interval_from_its_header() {
    let record = open_scope(&fixture("DS1074Z-A.csv"), None).unwrap();
    assert_eq!(
        (record.kind, record.names.as_slice()),
        ("table", ["CH1", "CH2", "CH3"].map(str::to_owned).as_slice())
    );
    near(record.interval_s, 2.0e-5, 1.0e-18);
    assert_eq!(
        (0..3)
            .map(|k| record.volts(k, 0, 1).unwrap()[0])
            .collect::<Vec<_>>(),
        [0.0, -1.0, 0.0]
    );
}

#[test]
fn siglents_tables_and_plain_ones_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    // The heads follow public examples of files; the numbers are synthetic.
    let new = "Record Length,Analog:4,\nSample Interval,Analog:1.000000E-03,\n\
    Vertical Units,CH1:V,CH3:V,\n,,\nSource,CH1,CH3\nSecond,Value,Value\n\
    +0.0E+00,+1.0E-02,+3.0E-02\n\
               +1.0E-03,+2.0E-02,+4.0E-02\n+2.0E-03,+1.0E-02,+3.0E-02\n\
               +3.0E-03,+2.0E-02,+4.0E-02\n";
    let old = "Record Length,Analog:3\nSample Rate,1000.0\nVertical Scale,CH1: 0.05\n\
    Vertical Offset,CH1:0.00000\nHorizontal Scale, 0.01\n\
               Second,Volt\n-0.001,-0.194\n0.000,-0.192\n0.001,-0.194\n";
    for (text, names, last) in [
        (new, vec!["CH1", "CH3"], 0.02),
        (old, vec!["Volt"], -0.194),
        ("time_s,a\n0,1\n0.001,2\n", vec!["a"], 2.0),
    ] {
        std::fs::write(&path, text).unwrap();
        let record = open_scope(&path, None).unwrap();
        near(record.interval_s, 1.0e-3, 1.0e-12);
        assert_eq!(record.names, names);
        assert_eq!(record.volts(0, record.samples - 1, 1).unwrap(), [last]);
    }
    std::fs::write(&path, "1 2\n3 4\n").unwrap();
    assert_eq!(open_scope(&path, Some(0.5)).unwrap().interval_s, 0.5);
    let message = open_scope(&path, None).unwrap_err().to_string();
    assert!(
        message.ends_with(
            "line 1: expected the time between two samples, in the header or a column of times; or \
            given as `interval`, met none"
        ),
        "{message}"
    );
    std::fs::write(&path, "a,b\n1,2\n3\n").unwrap();
    let message = open_scope(&path, Some(1.0)).unwrap_err().to_string();
    assert!(
        message.ends_with("a.csv, line 3: expected 2 numbers, met \"3\""),
        "{message}"
    );
    std::fs::write(&path, [0_u8, 1, 2, 3]).unwrap();
    let message = open_scope(&path, None).unwrap_err().to_string();
    assert!(
        message.ends_with("or a CSV with rows of numbers), met bytes 00 01 02 03"),
        "{message}"
    );
}

/// A session of sigrok: its metadata and pieces of channels.
fn session(path: &std::path::Path, metadata: &str, pieces: &[(&str, Vec<u8>)]) {
    use std::io::Write as _;
    let mut archive = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
    let deflated = zip::write::SimpleFileOptions::default();
    let texts = [("version", b"2".to_vec()), ("metadata", metadata.into())];
    for (name, content) in texts.iter().chain(pieces) {
        archive.start_file(*name, deflated).unwrap();
        archive.write_all(content).unwrap();
    }
    archive.finish().unwrap();
}

#[test]
fn a_session_of_sigrok_gives_its_analog_channels() {
    let floats = |from: u16, to: u16| -> Vec<u8> {
        let of = |k: u16| (0.25 * f32::from(k)).to_le_bytes();
        (from..to).flat_map(of).collect()
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.sr");
    // Logic channels are numbered before the analog ones; there are more than nine pieces.
    let metadata = "[global]\nsigrok version=0.5.2\n\n[device 1]\ncapturefile=logic-1\ntotal \
                    probes=1\nsamplerate=200 kHz\ntotal analog=2\nprobe1=TRIG\nanalog2=CH1\n\
                    analog3=CH2\nunitsize=1\n";
    let mut pieces: Vec<(String, Vec<u8>)> = (0..11)
        .map(|k| {
            (
                format!("analog-1-2-{}", k + 1),
                floats(10 * k, 10 * (k + 1)),
            )
        })
        .collect();
    pieces.push(("analog-1-3-1".to_owned(), floats(500, 610)));
    pieces.push(("logic-1-1".to_owned(), vec![1; 110]));
    let written = |metadata: &str, pieces: &[(String, Vec<u8>)]| {
        let pieces: Vec<(&str, Vec<u8>)> = pieces
            .iter()
            .map(|(name, content)| (name.as_str(), content.clone()))
            .collect();
        session(&path, metadata, &pieces);
        open_scope(&path, None)
    };
    let record = written(metadata, &pieces).unwrap();
    assert_eq!((record.kind, record.samples), ("sigrok session", 110));
    assert_eq!(record.names, ["CH1", "CH2"]);
    near(record.interval_s, 5.0e-6, 1.0e-18);
    assert_eq!(record.volts(0, 99, 3).unwrap(), [24.75, 25.0, 25.25]);
    assert_eq!(record.volts(1, 0, 1).unwrap(), [125.0]);
    let Some(Channel::Stored(stored)) = record.channel(1) else {
        panic!("no channel")
    };
    assert_eq!((stored.lsb_v, stored.level_v), (Some(0.25), 125.0));
    let mut gap = pieces.clone();
    gap[3].1[4..8].copy_from_slice(&f32::NAN.to_le_bytes());
    let mut cut = pieces.clone();
    cut[2].1.pop();
    for (metadata, pieces, words) in [
        (metadata, &gap, "CH1: analog-1-2-4: sample 30 of all is NaN"),
        (
            metadata,
            &cut,
            "CH1: analog-1-2-3: it ends within a sample of 4 bytes",
        ),
        (
            metadata,
            &pieces[..11].to_vec(),
            "more than none, met 0 of CH2",
        ),
        (
            &metadata.replace("kHz", "rpm"),
            &pieces,
            "samplerate: expected a number with Hz",
        ),
        (
            &metadata.replace("analog2", "x").replace("analog3", "y"),
            &pieces,
            "met none: logic",
        ),
        (
            &(metadata.to_owned() + "[device 2]\n"),
            &pieces,
            "devices: expected one, met 2",
        ),
    ] {
        let message = written(metadata, pieces).unwrap_err().to_string();
        assert!(message.contains(words), "{message}");
    }
    // Another archive is not a session.
    session(&path, metadata, &[]);
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let message = open_scope(&path, None).unwrap_err().to_string();
    assert!(
        message.ends_with("met bytes 50 4b 03 04 14 00 00 00"),
        "{message}"
    );
}

#[test]
fn tables_of_rohde_und_schwarz_are_read_with_their_settings() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // RTB and RTM; Batronix writes the same with one word more.
    for head in ["in s,C1 in V,C2 in V", "time in s,C1 in V,C2 in V"] {
        let text =
            format!("{head}\n-2.0E-03,1.5E-01,3.7\n-1.0E-03,2.5E-01,3.6\n0.0E+00,1.5E-01,3.7\n");
        std::fs::write(at("rtb.CSV"), text).unwrap();
        let record = open_scope(&at("rtb.CSV"), None).unwrap();
        assert_eq!(record.names, ["C1", "C2"], "{head}");
        near(record.interval_s, 1.0e-3, 1.0e-15);
        assert_eq!(record.volts(0, 0, 3).unwrap(), [0.15, 0.25, 0.15]);
    }
    // RTO: settings and samples, opened by either name.
    let one =
        "Resolution:2e-06:\nRecordLength:3:\nSource:Ch2:\nBaseUnit:V:\nNumberOfAcquisitions:1:\n";
    let two = "Resolution:2e-06:\nSignalRecordLength:3:\nMultiChannelExport:On:\n\
               MultiChannelExportState:4:On:Off:On:Off:\nMultiChannelSource:4:Ch1:Ch2:Ch3:Ch4:\n\
               MultiChannelViewUnit:4:V:V:A:V:\n";
    for (settings, rows, names) in [
        (one, "0.5\n0.25\n0.5\n", vec!["Ch2"]),
        (two, "0.5,1\n0.25,2\n0.5,1\n", vec!["Ch1", "Ch3"]),
        (
            two,
            "0,0.5,1\n2e-6,0.25,2\n4e-6,0.5,1\n",
            vec!["Ch1", "Ch3"],
        ),
    ] {
        std::fs::write(at("r.csv"), settings).unwrap();
        std::fs::write(at("r.Wfm.csv"), rows).unwrap();
        for name in ["r.csv", "r.Wfm.csv"] {
            let record = open_scope(&at(name), None).unwrap();
            assert_eq!((record.kind, record.samples), ("Rohde & Schwarz CSV", 3));
            assert_eq!(
                (&record.names, record.interval_s),
                (&names.iter().map(|n| (*n).to_owned()).collect(), 2e-6)
            );
            assert_eq!(record.volts(0, 0, 3).unwrap(), [0.5, 0.25, 0.5], "{name}");
        }
    }
    for (from, to, words) in [
        (
            "Resolution:2e-06",
            "Resolution:0",
            "Resolution: expected the time between two samples, s, met 0",
        ),
        (
            "Length:3",
            "Length:4",
            "RecordLength: expected 4, met 3 rows of",
        ),
        ("V:A:V", "V:dBm:V", "unit: expected V or A, met dBm of Ch3"),
        ("Off:On", "On:On", "channels: expected 3, met 1 in a row of"),
    ] {
        std::fs::write(at("r.csv"), two.replacen(from, to, 1)).unwrap();
        std::fs::write(
            at("r.Wfm.csv"),
            if to == "On:On" {
                "1\n2\n3\n"
            } else {
                "1,1\n2,2\n3,3\n"
            },
        )
        .unwrap();
        let message = open_scope(&at("r.Wfm.csv"), None).unwrap_err().to_string();
        assert!(message.contains(words), "{message}");
    }
    std::fs::write(
        at("r.csv"),
        one.replace("Acquisitions:1", "Acquisitions:20"),
    )
    .unwrap();
    let message = open_scope(&at("r.csv"), None).unwrap_err().to_string();
    assert!(
        message.contains("NumberOfAcquisitions: expected 1, met 20"),
        "{message}"
    );
}

#[test]
fn damaged_files_are_refused_and_nothing_panics() {
    let folder = tempfile::tempdir().unwrap();
    let mut state = 3_u64;
    for name in [
        "SDS814X-3v0-probe10x.bin",
        "DHO824-ch12.bin",
        "lecroy_4.trc",
    ] {
        let whole = std::fs::read(fixture(name)).unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, &whole[..whole.len() - 3]).unwrap();
        assert!(open_scope(&path, None).is_err(), "{name} cut short");
        for _ in 0..300 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            let mut bytes = whole.clone();
            let at = (state >> 20) as usize % 0x300.min(bytes.len());
            bytes[at] ^= (state >> 50) as u8 | 1;
            std::fs::write(&path, bytes).unwrap();
            // Any result is allowed, but no panic.
            let _ =
                open_scope(&path, None).map(|record| record.volts(0, 0, record.samples.min(100)));
        }
    }
}

#[test]
fn samples_on_disk_give_the_same_fit_as_samples_in_memory() {
    let record = open_scope(&fixture("DHO824-ch12.bin"), None).unwrap();
    let stored = [record.channel(0).unwrap(), record.channel(1).unwrap()];
    let volts = [0, 1].map(|k| record.volts(k, 0, record.samples).unwrap());
    let whole = volts.each_ref().map(|v| Channel::volts(v));
    let fit = |channels: &[Channel<'_>]| {
        fit_known_frequency(
            &Record {
                channels,
                interval_s: record.interval_s,
            },
            1000.0,
            &FitOptions::default(),
        )
        .unwrap()
    };
    assert_eq!(
        fit(&stored)
            .channels
            .iter()
            .map(|c| c.phasor)
            .collect::<Vec<_>>(),
        fit(&whole)
            .channels
            .iter()
            .map(|c| c.phasor)
            .collect::<Vec<_>>()
    );
}

#[test]
fn a_keysight_binary_gives_its_floats_channel_by_channel() {
    let samples = [0.5_f32, -0.25, 0.125];
    let mut file = b"AG10".to_vec();
    file.extend(0_u32.to_le_bytes());
    file.extend(2_u32.to_le_bytes());
    for label in ["1", "2"] {
        let mut header = vec![0; 140];
        header[..4].copy_from_slice(&140_u32.to_le_bytes());
        header[4..8].copy_from_slice(&1_u32.to_le_bytes());
        header[8..12].copy_from_slice(&1_u32.to_le_bytes());
        header[12..16].copy_from_slice(&3_u32.to_le_bytes());
        header[32..40].copy_from_slice(&2e-6_f64.to_le_bytes());
        header[112..113].copy_from_slice(label.as_bytes());
        file.extend(header);
        file.extend(12_u32.to_le_bytes());
        file.extend(1_u16.to_le_bytes());
        file.extend(4_u16.to_le_bytes());
        file.extend(12_u32.to_le_bytes());
        samples.iter().for_each(|v| file.extend(v.to_le_bytes()));
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scope_0.bin");
    std::fs::write(&path, &file).unwrap();
    let record = open_scope(&path, None).unwrap();
    assert_eq!((record.kind, record.samples), ("Keysight binary", 3));
    assert_eq!(
        (record.names.as_slice(), record.interval_s),
        (["1", "2"].map(str::to_owned).as_slice(), 2e-6)
    );
    assert_eq!(record.volts(1, 0, 3).unwrap(), [0.5, -0.25, 0.125]);
    for length in 0..file.len() {
        std::fs::write(&path, &file[..length]).unwrap();
        assert!(open_scope(&path, None).is_err(), "{length}");
    }
}
