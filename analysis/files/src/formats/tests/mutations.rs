//! Passes damaged files to every reader: no reader may panic, take long, use much memory, or return
//! a number that cannot be a measurement.
//!
//! The inputs are mutations of files that other programs wrote. Text is mutated by tokens and lines,
//! binary files by bytes and counts, members of archives and compressed variables inside their
//! container, which stays valid.

use std::{
    collections::BTreeMap,
    fs,
    io::{Cursor, Read, Write},
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
    time::Instant,
};

use flate2::{Compression, read::ZlibDecoder, write::ZlibEncoder};
use zip::{ZipArchive, ZipWriter, write::SimpleFileOptions};

use analysis_forward::forward::{Demand, Interpolation};

use super::parse_file;
use crate::formats::{
    ReadOptions, SeriesOptions, SeriesReadError, read_profile, read_record, scope::open_scope,
};

/// Default number of inputs, if [`NUMBER`] is not set.
const USUAL_NUMBER: u64 = 20_000;
/// Environment variable with the number of inputs.
const NUMBER: &str = "EIS_BENCH_MUTATIONS";
/// Environment variable with the first seed.
const SEED: &str = "EIS_BENCH_SEED";
/// Largest file that is mutated, bytes.
const MOST_BYTES: u64 = 200_000;
/// Maximum memory of this process, MB.
const MOST_MB: u64 = 2_000;
/// Number of threads.
const THREADS: u64 = 2;

/// A generator of random numbers (SplitMix64; Steele, Lea, Flood 2014).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number below `end`; 0 if `end` is 0.
    fn below(&mut self, end: usize) -> usize {
        (self.next() % (end.max(1) as u64)) as usize
    }

    fn pick<'a, T>(&mut self, of: &'a [T]) -> &'a T {
        &of[self.below(of.len())]
    }
}

/// A file to begin with.
struct Seed {
    name: String,
    bytes: Vec<u8>,
}

/// Files of the repository and, if available, those beside the checkout.
fn seeds() -> Vec<Seed> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut folders: Vec<PathBuf> = ["spectra", "series", "profiles", "captures", "cells"]
        .map(|name| root.join("fixtures/data").join(name))
        .to_vec();
    folders.extend(["cases", "formats"].map(|name| root.join("../shared/data").join(name)));
    let mut seeds = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).into_iter().flatten() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let size = path.metadata().unwrap().len();
            let is_note = path.extension().is_some_and(|ending| ending == "md");
            if (1..=MOST_BYTES).contains(&size) && !is_note {
                seeds.push(Seed {
                    name: path.file_name().unwrap().to_string_lossy().into_owned(),
                    bytes: fs::read(path).unwrap(),
                });
            }
        }
    }
    seeds.sort_by(|a, b| (&a.name, a.bytes.len()).cmp(&(&b.name, b.bytes.len())));
    seeds
}

fn is_text(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(512)];
    !head.is_empty() && head.iter().all(|byte| *byte >= 9 && *byte != 127)
}

/// Mutates a file by its structure.
fn mutated(seed: &Seed, others: &[Seed], random: &mut Random) -> Vec<u8> {
    let bytes = &seed.bytes;
    // Keep a container valid in most cases, so that its content is reached.
    let is_whole = random.below(5) != 0;
    if is_whole
        && bytes.starts_with(b"PK")
        && let Some(made) = repacked(bytes, random)
    {
        return made;
    }
    if is_whole
        && bytes.starts_with(b"MATLAB 5.0")
        && let Some(made) = recompressed(bytes, random)
    {
        return made;
    }
    let mut made = bytes.clone();
    for _ in 0..=random.below(4) {
        made = if is_text(bytes) && random.below(8) != 0 {
            mutated_text(&made, &random.pick(others).bytes, random)
        } else {
            mutated_bytes(&made, random)
        };
    }
    made
}

/// Unpacks an archive, mutates one member, and packs it again.
fn repacked(bytes: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let mut archive = ZipArchive::new(Cursor::new(bytes)).ok()?;
    let hit = random.below(archive.len());
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for index in 0..archive.len() {
        let mut member = archive.by_index(index).ok()?;
        let mut content = Vec::new();
        member.read_to_end(&mut content).ok()?;
        if index == hit {
            for _ in 0..=random.below(4) {
                content = match is_text(&content) {
                    true => mutated_text(&content, b"", random),
                    false => mutated_bytes(&content, random),
                };
            }
            // A member may also be missing.
            if random.below(16) == 0 {
                continue;
            }
        }
        let name = member.name().ok()?.to_string();
        drop(member);
        writer.start_file(name, SimpleFileOptions::default()).ok()?;
        writer.write_all(&content).ok()?;
    }
    Some(writer.finish().ok()?.into_inner())
}

/// Mutates one compressed variable of a MATLAB 5 file inside its compression.
fn recompressed(bytes: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let word = |at: usize| {
        let four = bytes.get(at..at + 4)?;
        Some(u32::from_le_bytes(four.try_into().ok()?) as usize)
    };
    let (mut at, mut elements) = (128, Vec::new());
    while let (Some(kind), Some(size)) = (word(at), word(at + 4)) {
        elements.push((at, kind, size));
        at += 8 + size;
    }
    if elements.is_empty() {
        return None;
    }
    let &(at, kind, size) = random.pick(&elements);
    if kind != 15 {
        return None;
    }
    let mut content = Vec::new();
    ZlibDecoder::new(bytes.get(at + 8..at + 8 + size)?)
        .read_to_end(&mut content)
        .ok()?;
    for _ in 0..=random.below(4) {
        content = mutated_bytes(&content, random);
    }
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(&content).ok()?;
    let packed = encoder.finish().ok()?;
    let mut made = bytes[..at].to_vec();
    made.extend(15_u32.to_le_bytes());
    made.extend((packed.len() as u32).to_le_bytes());
    made.extend(packed);
    made.extend(&bytes[at + 8 + size..]);
    Some(made)
}

/// Edge values of counts, sizes and numbers in binary files.
const WORDS: [u64; 12] = [
    0,
    1,
    2,
    0x7f,
    0xff,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0xffff_ffff,
    0x7ff8_0000_0000_0000,
    0x7ff0_0000_0000_0000,
    u64::MAX,
];

fn mutated_bytes(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut made = bytes.to_vec();
    let at = random.below(made.len());
    match random.below(7) {
        0 => made.truncate(at),
        1 => {
            let width = 1 << random.below(4);
            let word = random.pick(&WORDS).to_le_bytes();
            let end = (at + width).min(made.len());
            made[at..end].copy_from_slice(&word[..end - at]);
        }
        2 => {
            for _ in 0..=random.below(8) {
                let at = random.below(made.len());
                if let Some(byte) = made.get_mut(at) {
                    *byte = random.next() as u8;
                }
            }
        }
        3 => {
            let end = (at + random.below(64)).min(made.len());
            made.drain(at..end);
        }
        4 => {
            let end = (at + random.below(512)).min(made.len());
            let piece = made[at..end].to_vec();
            made.splice(at..at, piece);
        }
        5 => {
            let zeros = vec![*random.pick(&[0, 0xff, b' ']); random.below(64)];
            made.splice(at..at, zeros);
        }
        _ => {
            if let Some(byte) = made.get_mut(at) {
                *byte ^= 1 << random.below(8);
            }
        }
    }
    made
}

/// Fields that programs and people write instead of a number.
const FIELDS: [&str; 24] = [
    "",
    "NaN",
    "-nan(ind)",
    "inf",
    "-inf",
    "9.9E37",
    "9.91e37",
    "OVERLOAD",
    "1e999",
    "1e-999",
    "-",
    "0",
    "-0",
    "1,5",
    "1.234.567,8",
    "1 234,5",
    "\u{2212}0.5",
    "1D-3",
    "0x1F",
    "12:34:56",
    "2026-07-01 12:00:00",
    "true",
    "99999999999999999999999999",
    "\"a\"\"b\"",
];

fn mutated_text(bytes: &[u8], other: &[u8], random: &mut Random) -> Vec<u8> {
    let mut lines: Vec<Vec<u8>> = bytes
        .split(|byte| *byte == b'\n')
        .map(<[u8]>::to_vec)
        .collect();
    let at = random.below(lines.len());
    match random.below(14) {
        0 => {
            lines.remove(at);
        }
        1 => lines.insert(at, lines[at].clone()),
        2 => {
            let with = random.below(lines.len());
            lines.swap(at, with);
        }
        3 => lines.truncate(at + 1),
        4 => lines.insert(at, Vec::new()),
        5 => {
            let from: Vec<&[u8]> = other.split(|byte| *byte == b'\n').collect();
            lines.insert(at, from[random.below(from.len())].to_vec());
        }
        6 => {
            let (from, to) = *random.pick(&[
                (b',', b';'),
                (b',', b'\t'),
                (b';', b','),
                (b'\t', b' '),
                (b'.', b','),
                (b',', b'.'),
                (b'\t', b','),
            ]);
            for byte in lines.iter_mut().flatten() {
                *byte = if *byte == from { to } else { *byte };
            }
        }
        7 => lines.iter_mut().for_each(|line| line.push(b'\r')),
        8 => lines[0].splice(0..0, *b"\xef\xbb\xbf").for_each(drop),
        9 => {
            let byte = *random.pick(&[0, 0xff, b'"', 0xb5, b'%', b'#']);
            let column = random.below(lines[at].len() + 1);
            lines[at].insert(column, byte);
        }
        10 => return lines.join(&b"\r\n"[..]),
        11 => {
            // One column of all rows.
            let column = random.below(8);
            let field = random.pick(&FIELDS).as_bytes();
            lines
                .iter_mut()
                .skip(at)
                .for_each(|line| *line = replaced(line, column, field));
        }
        12 => {
            let column = random.below(8);
            let number = format!(
                "{:e}",
                (random.next() as f64 - 9.0e18) * 10_f64.powi(random.below(60) as i32 - 40)
            );
            lines[at] = replaced(&lines[at], column, number.as_bytes());
        }
        _ => {
            let column = random.below(8);
            let field = *random.pick(&FIELDS);
            lines[at] = replaced(&lines[at], column, field.as_bytes());
        }
    }
    lines.join(&b'\n')
}

/// A line with another field.
fn replaced(line: &[u8], column: usize, field: &[u8]) -> Vec<u8> {
    let is_between = |byte: &u8| matches!(byte, b',' | b';' | b'\t');
    let between = line
        .iter()
        .find(|byte| is_between(byte))
        .copied()
        .unwrap_or(b' ');
    let mut fields: Vec<&[u8]> = line.split(|byte| *byte == between).collect();
    if let Some(place) = fields.get_mut(column) {
        *place = field;
    }
    fields.join(&between)
}

/// Reads an input with every reader that may accept it; returns the results.
fn read_all(path: &Path, bytes: &[u8]) -> Vec<&'static str> {
    let mut read = Vec::new();
    if let Ok(file) = parse_file(path, bytes) {
        let points = file
            .spectra
            .iter()
            .flat_map(|spectrum| &spectrum.spectrum.points);
        for point in points {
            let is_measured =
                point.freq_hz > 0.0 && point.freq_hz.is_finite() && point.z_ohm.is_finite();
            assert!(
                is_measured && point.z_ohm.re.abs().max(point.z_ohm.im.abs()) < 9.0e37,
                "{point:?}"
            );
        }
        read.push("spectra");
    }
    match read_record(path, &SeriesOptions::default()) {
        Ok(record) => {
            let series = record.series;
            let all = [&series.time_s, &series.voltage_v, &series.current_a];
            let is_measured = all.iter().all(|column| column.len() == series.time_s.len());
            assert!(is_measured && all.into_iter().flatten().all(|value| value.is_finite()));
            assert!(series.time_s.is_sorted_by(|a, b| a < b));
            read.push("series");
        }
        Err(error) => check_error(path, &error),
    }
    let options = ReadOptions {
        demand: Some(Demand::Current),
        interpolation: Interpolation::Hold,
        charge_positive: false,
    };
    if read_profile(path, &options).is_ok() {
        read.push("profile");
    }
    if let Ok(record) = open_scope(path, Some(1.0e-6)) {
        let volts = record.volts(0, 0, 64);
        assert!(volts.is_err() || volts.is_ok_and(|volts| volts.len() <= 64));
        read.push("scope");
    }
    read
}

/// An error must name its file and must be short.
fn check_error(path: &Path, error: &SeriesReadError) {
    let text = error.to_string();
    let name = path.file_name().unwrap().to_string_lossy();
    assert!(text.contains(&*name) && text.len() < 4_000, "{text}");
}

/// Returns the peak memory of this process, MB.
fn peak_mb() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kb = line.and_then(|line| {
        line.trim()
            .trim_end_matches("kB")
            .trim()
            .parse::<u64>()
            .ok()
    });
    kb.unwrap_or_default() / 1000
}

fn of_environment(name: &str, usual: u64) -> u64 {
    std::env::var(name).map_or(usual, |text| text.parse().unwrap())
}

#[test]
#[ignore = "long drill: a minute; EIS_BENCH_MUTATIONS=N for more"]
fn damaged_files_are_refused_or_read_as_numbers() {
    let (seeds, number) = (seeds(), of_environment(NUMBER, USUAL_NUMBER));
    let first = of_environment(SEED, 1);
    let folder = tempfile::tempdir().unwrap();
    let done = AtomicU64::new(0);
    let (seeds, done, folder) = (&seeds, &done, folder.path());
    let work = |thread: u64| {
        let (mut slowest, mut read) = ((0.0, String::new()), BTreeMap::<&str, u64>::new());
        for index in (thread..number).step_by(THREADS as usize) {
            let mut random = Random(first.wrapping_mul(0x1_0000_0000).wrapping_add(index));
            let seed = random.pick(seeds);
            let bytes = mutated(seed, seeds, &mut random);
            let own = folder.join(thread.to_string());
            fs::create_dir_all(&own).unwrap();
            let path = own.join(&seed.name);
            fs::write(&path, &bytes).unwrap();
            #[expect(clippy::disallowed_methods, reason = "the time is printed only")]
            let begin = Instant::now();
            // Print the seed and the number of a failing input.
            let kinds = std::panic::catch_unwind(|| read_all(&path, &bytes));
            let kinds =
                kinds.unwrap_or_else(|_| panic!("{}: seed {first}, input {index}", seed.name));
            let took_s = begin.elapsed().as_secs_f64();
            if took_s > slowest.0 {
                slowest = (
                    took_s,
                    format!("{} of {} bytes, input {index}", seed.name, bytes.len()),
                );
            }
            let kinds = if kinds.is_empty() {
                vec!["refused"]
            } else {
                kinds
            };
            kinds
                .into_iter()
                .for_each(|kind| *read.entry(kind).or_default() += 1);
            fs::remove_file(path).unwrap();
            if done.fetch_add(1, Ordering::Relaxed) % 1000 == 0 {
                assert!(
                    peak_mb() < MOST_MB,
                    "{}: input {index}: {} MB",
                    seed.name,
                    peak_mb()
                );
            }
        }
        (slowest, read)
    };
    let results: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..THREADS)
            .map(|thread| scope.spawn(move || work(thread)))
            .collect();
        threads
            .into_iter()
            .map(|thread| thread.join().unwrap())
            .collect()
    });
    println!(
        "{number} inputs from {} files, seed {first}, {} MB at most",
        seeds.len(),
        peak_mb()
    );
    for ((took_s, what), read) in results {
        println!("slowest {took_s:.2} s: {what}; {read:?}");
    }
}
