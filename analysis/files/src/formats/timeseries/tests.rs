//! Tables of cyclers, made up by the columns that their programs write.

use super::*;

fn read(name: &str, text: &[u8]) -> Result<TimeSeries, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    read_series(&path, &SeriesOptions::default()).map_err(|error| error.to_string())
}

/// Two rows: at 0 s 4.1 V and 2 A of discharge, at 36 s 4.0 V and 0.5 A of charge.
fn holds(text: &str) {
    let series = read("x.txt", text.as_bytes()).unwrap_or_else(|error| panic!("{error}\n{text}"));
    let alike = |met: &[f64], expected: [f64; 2]| {
        met.len() == 2 && met.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9)
    };
    assert!(
        alike(&series.time_s, [0.0, 36.0])
            && alike(&series.voltage_v, [4.1, 4.0])
            && alike(&series.current_a, [2.0, -0.5]),
        "{series:?}\n{text}"
    );
}

#[test]
fn each_cycler_is_read_by_its_columns() {
    for text in [
        // Arbin, two spellings.
        "Data_Point,Test_Time(s),Step_Time(s),Current(A),Voltage(V)\n1,0,0,-2,4.1\n2,36,36,0.5,4.0\n",
        "Date Time,Test Time (s),Current (A),Voltage (V)\na,0,-2,4.1\nb,36,0.5,4.0\n",
        // Basytec.
        "~Resultfile from Basytec Battery Test System\n~Date: today\n\
        ~Time[h]\tDataSet\tU[V]\tI[A]\tT1[°C]\n0\t1\t4.1\t-2\t25\n0.01\t2\t4.0\t0.5\t25\n",
        // EC-Lab.
        "BT-Lab ASCII FILE\nNb header lines : 3\nmode\ttime/s\tEwe/V\t<I>/mA\n\
        1\t0,0E0\t4,1\t-2000\n1\t3,6E1\t4,0\t500\n",
        // Digatron, with a row of units that the names have too.
        "Program;P1\nStep;Prog Time [h];Spannung [V];Strom [A]\n;;;\n1;0;4,1;-2\n1;0,01;4,0;0,5\n",
        // Maccor: currents without sign.
        "Today's Date\t1\nRec#\tCyc#\tStep\tTest (Min)\tState\tAmps\tVolts\n\
        1\t0\t1\t0\tD\t2\t4.1\n2\t0\t2\t0.6\tC\t0.5\t4.0\n",
        // Neware: a clock, and the time of the step beside the whole.
        "DataPoint,Cycle Index,Step Index,Step Type,Time,Total Time,Current(mA),Voltage(V)\n\
        1,1,1,CC DChg,0:00:00,0:00:00,-2000,4.1\n2,1,2,CC Chg,0:00:00,0:00:36,500,4.0\n",
        // Novonix.
        "[Summary]\nNovonix UHPC File\n[End Summary]\n[Data]\n\
        Date and Time,Cycle Number,Run Time (h),Current (A),Potential (V)\n\
        a,1,0,-2,4.1\na,1,0.01,0.5,4.0\n",
        // PEC.
        "TestRegime Name:,x\nTest,Cell,Total Time (Seconds),Voltage (mV),Current (mA)\n\
        1,1,0,4100,-2000\n1,1,36,4000,500\n",
        // BDF with milliseconds, for people and for machines.
        "Test Time / ms,Voltage / V,Current / A\n0,4.1,-2\n36000,4.0,0.5\n",
        "test_time_millisecond,voltage_volt,current_ampere\n0,4.1,-2\n36000,4.0,0.5\n",
    ] {
        holds(text);
    }
    let bytes: Vec<u8> = "Test Time / s,Voltage / V,Current / A\n0,4.1,-2\n36,4.0,0.5\n"
        .encode_utf16()
        .flat_map(u16::to_le_bytes)
        .collect();
    let series = read("x.csv", &[b"\xFF\xFE".as_slice(), &bytes].concat()).unwrap();
    assert_eq!(series.time_s, [0.0, 36.0]);
}

#[test]
fn of_rows_at_one_time_the_last_is_kept() {
    let text = "Test Time / s,Voltage / V,Current / A\n0,4.1,0\n1,4.1,0\n1,4.0,-2\n2,3.9,-2\n";
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.bdf.csv");
    std::fs::write(&path, text).unwrap();
    let ReadSeries {
        series, left_out, ..
    } = read_record(&path, &SeriesOptions::default()).unwrap();
    assert_eq!(series.time_s, [0.0, 1.0, 2.0]);
    assert_eq!(series.current_a, [-0.0, 2.0, 2.0]);
    assert_eq!(left_out.len(), 1);
    assert!(left_out[0].replaced);
    assert_eq!((left_out[0].line, left_out[0].time_s), (3, 1.0));
    let back = read("x.csv", text.replace("\n2,", "\n0.5,").as_bytes()).unwrap_err();
    assert!(back.contains("expected times in s that rise"), "{back}");
}

#[test]
fn currents_without_a_direction_are_not_guessed() {
    let text = "Test Time (s),Current (A),Voltage (V)\n0,2,4.1\n36,2,4.0\n";
    let told = read("x.txt", text.as_bytes()).unwrap_err();
    assert!(told.contains("its currents are all of one sign"), "{told}");
    assert_eq!(
        read("x_discharge.txt", text.as_bytes()).unwrap().current_a,
        [2.0, 2.0]
    );
}

#[test]
fn what_is_wrong_is_told_with_its_line_in_the_file() {
    for (text, told) in [
        (
            "head\nTest Time (s),Current (A),Voltage (V)\n0,-2,4.1\n36,x,4.0\n",
            "line 4, column 2",
        ),
        (
            "head\nTotal Time,Current(mA),Voltage(V)\n0:00:00,-2,4.1\n0:61:00,1,4.0\n",
            "line 4, column 1",
        ),
        (
            "Test Time (fortnights),Current (A),Voltage (V)\n0,1,1\n",
            "line 1",
        ),
        ("Test Time (s),Current (kA),Voltage (V)\n0,1,1\n", "line 1"),
    ] {
        let met = read("x.txt", text.as_bytes()).unwrap_err();
        assert!(met.contains(told), "{met}\n{text}");
    }
}
