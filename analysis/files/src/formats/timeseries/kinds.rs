//! Kinds of logs that were read wrongly or refused for a wrong reason, reduced and with synthetic
//! numbers.

use super::*;
use proptest::prelude::*;

/// Time, voltage and current, charge positive: rest, 3 A out, rest, 1.2 A in, rest, at 1 s.
fn rows() -> Vec<[f64; 3]> {
    let of = |k: i32| {
        let t = f64::from(k);
        match k {
            20..40 => [t, 3.9 - 0.09 - 0.001 * (t - 20.0), -3.0],
            40..60 => [t, 3.89 - 0.01, 0.0],
            60..80 => [t, 3.88 + 0.036 + 0.0004 * (t - 60.0), 1.2],
            80..100 => [t, 3.885, 0.0],
            _ => [t, 3.9, 0.0],
        }
    };
    (0..100).map(of).collect()
}

/// The log by a header and a function of a row and its number.
fn text(head: &str, row: impl Fn(usize, [f64; 3]) -> String) -> String {
    let lines = rows()
        .into_iter()
        .enumerate()
        .map(|(k, values)| row(k, values));
    head.to_owned() + "\n" + &lines.collect::<Vec<_>>().join("\n") + "\n"
}

fn read(name: &str, text: &str) -> Result<ReadSeries, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    read_record(&path, &SeriesOptions::default()).map_err(|error| error.to_string())
}

/// Asserts that a text is read like the log.
fn is_read(name: &str, text: &str) -> ReadSeries {
    let read = read(name, text).unwrap_or_else(|error| panic!("{error}\n{}", &text[..300]));
    assert_eq!(read.series.len(), 100, "{name}");
    for (k, [t, v, a]) in rows().into_iter().enumerate() {
        let met = (
            read.series.time_s[k],
            read.series.voltage_v[k],
            -read.series.current_a[k],
        );
        let near = (met.0 - t).abs() < 1e-6 && (met.1 - v).abs() < 1e-6 && (met.2 - a).abs() < 1e-6;
        assert!(
            near,
            "{name}, row {k}: {met:?}, not {:?}\n{}",
            (t, v, a),
            &text[..200]
        );
    }
    read
}

fn refused(name: &str, text: &str, words: &[&str]) {
    let message = read(name, text).expect_err(&text[..200]);
    assert!(words.iter().all(|word| message.contains(word)), "{message}");
}

fn word(a: f64) -> &'static str {
    if a > 0.0 {
        "CC Chg"
    } else if a < 0.0 {
        "CC DChg"
    } else {
        "Rest"
    }
}

#[test]
fn the_voltage_tells_the_direction_and_no_name_does() {
    for name in ["log.csv", "discharge.csv", "charge_25C.csv"] {
        for sign in [1.0, -1.0] {
            for head in [
                "Time,Voltage,Current",
                "Test Time / s,Voltage / V,Current / A",
                "Test_Time(s),Voltage(V),Current(A)",
                "time_s,voltage_v,current_a",
            ] {
                is_read(
                    name,
                    &text(head, |_, [t, v, a]| format!("{t},{v},{}", sign * a)),
                );
            }
        }
        // Magnitudes: the voltage determines the direction of each load.
        let read = is_read(
            name,
            &text("Time/s;U/V;I/A", |_, [t, v, a]| {
                format!("{t};{v};{}", a.abs())
            }),
        );
        assert!(
            read.notes.iter().any(|note| note.contains("magnitudes")),
            "{:?}",
            read.notes
        );
    }
    let turned = is_read(
        "x.bdf.csv",
        &text("Test Time / s,Voltage / V,Current / A", |_, [t, v, a]| {
            format!("{t},{v},{}", -a)
        }),
    );
    assert!(
        turned.notes[0].contains("count discharge positive"),
        "{:?}",
        turned.notes
    );
}

#[test]
fn words_and_counted_charge_tell_the_direction_where_the_voltage_is_silent() {
    let head = "Time/s,Voltage/V,Current/A,Step Type / 1";
    let flat = |k: usize, [t, _, a]: [f64; 3]| {
        format!("{t},{},{},{}", 3.3 + 0.01 * (k % 2) as f64, -a, word(a))
    };
    let silent = read("x.csv", &text(head, flat)).unwrap();
    assert_eq!(
        (silent.series.current_a[30], silent.series.current_a[70]),
        (3.0, -1.2)
    );
    let counted = |k: usize, [t, _, a]: [f64; 3]| {
        let out = 3.0 * (k.clamp(19, 39) - 19) as f64 / 3600.0;
        let into = 1.2 * (k.clamp(59, 79) - 59) as f64 / 3600.0;
        format!(
            "{t},{},{},{into},{out}",
            3.3 + 0.01 * (k % 2) as f64,
            a.abs()
        )
    };
    let head = "Time/s,Voltage/V,Current/A,Charge Capacity / Ah,Discharge Capacity / Ah";
    let counted = read("x.csv", &text(head, counted)).unwrap();
    assert_eq!(
        (counted.series.current_a[30], counted.series.current_a[70]),
        (3.0, -1.2)
    );
}

#[test]
fn contradictions_are_refused_with_their_rows() {
    // A word for charge while the voltage falls.
    let head = "Time/s,Voltage/V,Current/A,State";
    let wrong = text(head, |_, [t, v, a]| format!("{t},{v},{a},{}", word(-a)));
    refused("x.csv", &wrong, &["line 22", "--positive"]);
    let magnitudes = text(head, |_, [t, v, a]| {
        format!("{t},{v},{},{}", a.abs(), word(-a))
    });
    refused(
        "x.csv",
        &magnitudes,
        &["line 22", "while the voltage goes from"],
    );
    // The voltage falls in both directions of a signed current.
    let fall =
        |_: usize, [t, v, a]: [f64; 3]| format!("{t},{},{a}", if a > 0.0 { v - 0.1 } else { v });
    refused(
        "x.csv",
        &text("Time/s,Voltage/V,Current/A", fall),
        &["charge is positive by line"],
    );
    // The time contradicts a clock, the charge contradicts the current.
    let clock =
        |k: usize, [t, v, a]: [f64; 3]| format!("{},{},{v},{a}", 1e3 * t, 1_700_000_000 + k);
    let head = "Test Time / s,Unix Time / s,Voltage / V,Current / A";
    refused("x.csv", &text(head, clock), &["wall clock", "0.001"]);
    let counted = |k: usize, [t, v, a]: [f64; 3]| {
        format!("{t},{v},{a},{}", 3.0 * (k.clamp(19, 39) - 19) as f64 / 3.6)
    };
    let head = "Test Time / s,Voltage / V,Current / A,Discharge Capacity / Ah";
    refused("x.csv", &text(head, counted), &["a factor of 1000"]);
    // Milliamperes under A, beside a charge without direction.
    let counted = |k: usize, [t, v, a]: [f64; 3]| {
        let count = |from: usize, a: f64| a * (k.clamp(from, from + 20) - from) as f64 / 3600.0;
        format!("{t},{v},{},{}", 1e3 * a, count(19, 3.0) + count(59, 1.2))
    };
    let head = "Test Time / s,Voltage / V,Current / A,Capacity / Ah";
    refused("x.csv", &text(head, counted), &["a factor of 0.001"]);
}

#[test]
fn the_time_that_counts_the_whole_test_is_taken() {
    let clock = |t: f64| format!("{}:{:02}:{:06.3}", 0, (t / 60.0).floor(), t % 60.0);
    let step = |t: f64| t % 20.0;
    let head = "DataPoint,Step Type,Time,Cumulative Time,Current(A),Voltage(V)";
    is_read(
        "n.csv",
        &text(head, |k, [t, v, a]| {
            format!("{k},{},{},{},{a},{v}", word(a), clock(step(t)), clock(t))
        }),
    );
    // Three levels in one table: cycles, steps, records.
    let head = "Cycle ID,Cap_Chg(mAh)\n,Step ID,Step Name\n\
        ,,Record ID,Time(h:min:s.ms),Voltage(V),Current(mA),Realtime\n1,7.5\n,1,Rest";
    is_read(
        "three.csv",
        &text(head, |k, [t, v, a]| {
            format!(
                ",,{k},{},{v},{},2024-03-01 10:{:02}:{:06.3}",
                clock(step(t)),
                1e3 * a,
                (t / 60.0).floor(),
                t % 60.0
            )
        }),
    );
    // Dates alone, month first, by halves of the day.
    let head = "Date Time,Voltage (mV),Current (mA)";
    is_read(
        "d.csv",
        &text(head, |_, [t, v, a]| {
            format!(
                "3/14/2024 11:{:02}:{:02} PM,{},{}",
                (t / 60.0).floor(),
                t % 60.0,
                1e3 * v,
                1e3 * a
            )
        }),
    );
    let head = "Rec\tTestTime\tCap. [Ah]\tCurrent [A]\tVoltage [V]\tMd\tDPt Time";
    let maccor = |k: usize, [t, v, a]: [f64; 3], wall: bool| {
        let day = if wall {
            format!("3/14/2024 1:{:02}:{:02} PM", (t / 60.0).floor(), t % 60.0)
        } else {
            String::new()
        };
        let md = word(a).trim_start_matches("CC ").chars().next().unwrap();
        format!("{k}\t{}\t0\t{}\t{v}\t{md}\t{day}", t / 60.0, a.abs())
    };
    let read = is_read("m.txt", &text(head, |k, row| maccor(k, row, true)));
    assert!(read.notes[0].contains("counts 60 s"), "{:?}", read.notes);
    refused(
        "m.txt",
        &text(head, |k, row| maccor(k, row, false)),
        &["TestTime", "(Min)"],
    );
}

#[test]
fn names_of_whole_programs_are_read() {
    let csv = |_: usize, [t, v, a]: [f64; 3]| format!("{t},{v},{a}");
    for head in [
        "Test_Time,Voltage,Current",
        "Zeit [s],Spannung [V],Strom [A]",
        "Temps (s),Tension (V),Courant (A)",
        "测试时间(s),电压(V),电流(A)",
        "time in s,voltage in V,current in A",
        "Total Time (Seconds),Cell Voltage (V),Current (A)",
    ] {
        is_read("x.csv", &text(head, csv));
    }
    let tabs = |_: usize, [t, v, a]: [f64; 3]| format!("{t}\t{v}\t{}", 1e3 * a);
    is_read(
        "x.mpt",
        &text(
            "EC-Lab ASCII FILE\nNb header lines : 3\ntime/s\t<Ewe>/V\tI/mA",
            tabs,
        ),
    );
    is_read(
        "x.mpt",
        &text(
            "EC-Lab ASCII FILE\nNb header lines : 3\ntime/s\t<Ewe/V>\tI/mA",
            tabs,
        ),
    );
    let absolute = |_: usize, [t, v, a]: [f64; 3]| {
        format!(
            "02/03/2024 10:{:02}:{:07.4}\t{v}\t{}",
            (t / 60.0).floor(),
            t % 60.0,
            1e3 * a
        )
    };
    is_read(
        "x.mpt",
        &text(
            "EC-Lab ASCII FILE\nNb header lines : 3\ntime/s\tEcell/V\t<I>/mA",
            absolute,
        ),
    );
    let gamry = |k: usize, [t, v, a]: [f64; 3]| format!("\t{k}\t{t}\t{v}\t{a}\t...");
    is_read(
        "x.DTA",
        &text(
            "EXPLAIN\nTAG\tPWR800\nCURVE\tTABLE\t100\n\tPt\tT\tVf\tIm\tOver\n\t#\ts\tV vs. Ref.\tA\tbits",
            gamry,
        ),
    );
    let digatron = |_: usize, [t, v, a]: [f64; 3]| {
        let word = if a > 0.0 {
            "CHA"
        } else if a < 0.0 {
            "DCH"
        } else {
            "PAU"
        };
        format!(
            "{word},00:{:02}:{:06.3},{v},{a}",
            (t / 60.0).floor(),
            t % 60.0
        )
    };
    is_read(
        "x.csv",
        &text(
            "Made by,a\nStatus,Prog Time,Voltage,Current\n,,[V],[A]",
            digatron,
        ),
    );
    let blanks = |_: usize, [t, v, a]: [f64; 3]| format!("  {t}   {v} {a}");
    is_read("x.txt", &text("Time/s  U/V  I/A", blanks));
}

#[test]
fn rows_that_are_no_measurement_are_left_out_with_a_word() {
    let head = "Time/s,Voltage/V,Current/A";
    let odd = |k: usize, [t, v, a]: [f64; 3]| match k {
        5 => format!("{t},9.9E37,{a}"),
        6 => format!("{t},OVERLOAD,{a}"),
        7 => format!("{t},{v},nan"),
        8 => ",,".to_owned(),
        _ => format!("{t},{v},{a}"),
    };
    let read = read("x.csv", &text(head, odd)).unwrap();
    assert_eq!((read.series.len(), read.left_out.len()), (96, 3));
    assert!(
        read.notes[0].contains("3 rows") && read.notes[0].contains("line 7"),
        "{:?}",
        read.notes
    );
}

#[test]
fn refusals_say_what_is_missing() {
    let csv = |_: usize, [t, v, a]: [f64; 3]| format!("{t},{v},{a}");
    for (head, words) in [
        (
            "Time/s,Voltage/V,Level",
            ["it names a time and a voltage", "not a current"],
        ),
        (
            "Time/s,Voltage/V,Current/kA",
            ["the unit in \"Current/kA\"", "is not known"],
        ),
        (
            "Time/fortnight,Voltage/V,Current/A",
            ["not a time", "\"Time/fortnight\""],
        ),
    ] {
        refused("x.csv", &text(head, csv), &words);
    }
    let open = |mode: usize| {
        text(
            "EC-Lab ASCII FILE\nNb header lines : 3\nmode\ttime/s\tEwe/V",
            move |_, [t, v, _]| format!("{mode}\t{t}\t{v}"),
        )
    };
    assert!(
        read("x.mpt", &open(3))
            .unwrap()
            .series
            .current_a
            .iter()
            .all(|a| *a == 0.0)
    );
    refused("x.mpt", &open(1), &["without a current", "I/mA"]);
}

#[test]
fn times_that_stand_still_are_reported() {
    let head = "Test Time / s,Voltage / V,Current / A";
    let read = read(
        "x.csv",
        &text(head, |_, [t, v, a]| {
            format!("{},{v},{a}", (t / 5.0).floor())
        }),
    )
    .unwrap();
    assert_eq!(read.series.len(), 20);
    assert!(
        read.notes[0].contains("stands still in 80 rows"),
        "{:?}",
        read.notes
    );
}

#[test]
fn a_time_that_stands_still_beside_one_that_moves_is_passed_over() {
    // The first does not change; the second changes once in five rows, the clock in each.
    let head = "test_time_second,voltage_volt,current_ampere,unix_time_second";
    for coarse in [0.0, 0.2] {
        let rows = |_: usize, [t, v, a]: [f64; 3]| {
            format!("{},{v},{a},{}", (t * coarse).floor(), 1.7e9 + t)
        };
        let read = read("x.bdf.csv", &text(head, rows)).unwrap();
        assert_eq!(read.series.len(), 100, "{coarse}: {:?}", read.notes);
        assert!(
            read.notes[0].contains("taken from \"unix_time_second\", for \"test_time_second\""),
            "{:?}",
            read.notes
        );
    }
    // Without another one, the rows that are kept are read.
    let still = |_: usize, [t, v, a]: [f64; 3]| format!("{},{v},{a},1.7e9", (t * 0.2).floor());
    assert_eq!(
        read("x.bdf.csv", &text(head, still)).unwrap().series.len(),
        20
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn no_text_makes_it_panic(
        head in "(Test Time / s|Time|Unix Time / s|Voltage / V|U/V|Current / A|I/mA|State|Step|Md|mode|Date\
                 |Charge Capacity / Ah|Discharge Capacity / Ah|,|;|\t| |\"|#|\n){0,20}",
        soup in "([0-9]{1,3}|-|\\.|,|;|\t| |\"|\n|nan|9.9E37|D|C|R|1:02:03|2024-01-01 00:00:00|e|é|\u{2212}){0,80}",
    ) {
        let _ = table::read(Path::new("x"), format!("{head}\n{soup}").as_bytes());
        let _ = read("x.csv", &format!("Time,Voltage,Current\n{soup}"));
    }
}
