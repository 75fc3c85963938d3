//! Synthetic tables of cyclers with the columns that their programs write.

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
fn arbins_database_is_refused_with_the_command_whose_table_is_read() {
    let error = read("x.res", b"\0\x01\0\0Standard Jet DB\0 and pages").unwrap_err();
    assert!(
        error.contains("x.res: expected a record of time, voltage and current, met an Arbin .res"),
        "{error}"
    );
    assert!(
        error.contains("`mdb-export FILE Channel_Normal_Table > FILE.csv`"),
        "{error}"
    );
    // Columns of Channel_Normal_Table as mdb-export writes them: no units, days since 1900. A rest,
    // 2 A out, a rest.
    let mut text = "Test_ID,Data_Point,Test_Time,Step_Time,DateTime,Step_Index,Cycle_Index,\
                    Is_FC_Data,Current,Voltage,Charge_Capacity,Discharge_Capacity,Charge_Energy,\
                    Discharge_Energy,dV/dt,Internal_Resistance,AC_Impedance,ACI_Phase_Angle\n"
        .to_owned();
    for k in 0..36_i32 {
        let load = (12..24).contains(&k);
        let (amperes, volts) = if load { (-2.0, 3.9) } else { (0.0, 4.1) };
        let (time_s, out_ah) = (36 * k, 0.02 * f64::from((k - 12).clamp(0, 12)));
        let days = 42_614.5 + f64::from(time_s) / 86_400.0;
        text += &format!(
            "7,{k},{time_s}.0000000e+00,0,{days:.10},{},1,0,{amperes:.5e},{volts:.5e},0,{out_ah:.5e},\
             0,0,0,0,0,0\n",
            1 + k / 12
        );
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.csv");
    std::fs::write(&path, text).unwrap();
    let record = read_record(&path, &SeriesOptions::default()).unwrap();
    let (series, steps) = (&record.series, record.steps.as_ref().unwrap());
    assert_eq!((series.len(), steps[11], steps[12]), (36, 1.0, 2.0));
    assert_eq!(
        (
            series.time_s[35],
            series.voltage_v[12],
            series.current_a[12]
        ),
        (1260.0, 3.9, 2.0)
    );
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
    let message = read("x.txt", text.as_bytes()).unwrap_err();
    assert!(
        message.contains("its currents are all of one sign"),
        "{message}"
    );
    assert_eq!(
        read("x_discharge.txt", text.as_bytes()).unwrap().current_a,
        [2.0, 2.0]
    );
}

#[test]
fn what_is_wrong_is_reported_with_its_line_in_the_file() {
    for (text, message) in [
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
        assert!(met.contains(message), "{met}\n{text}");
    }
}

#[test]
fn names_that_are_units_are_read_where_each_stands_once() {
    for text in [
        "Seconds,Amps,Volts,Ah\n0,-2,4.1,0\n36,0.5,4.0,0.01\n",
        "Volts,Seconds,Amps\n4.1,0,-2\n4.0,36,0.5\n",
        "s;mV;mA\n0;4100;-2000\n36;4000;500\n",
        "made by a program\nh\tV\tA\n0\t4.1\t-2\n0.01\t4.0\t0.5\n",
        // TOYO.
        "Mode,Cycle,TotlCycle,PassTime[Sec],Voltage[V],Current[mA]\n1,1,1,0,4.1,-2000\n2,1,1,36,4.0,500\n",
        // Autolab NOVA, and its lists of the time domain.
        "Index\tCorrected time (s)\tTime (s)\tWE(1).Potential (V)\tWE(1).Current (A)\n\
         1\t0\t0\t4.1\t-2\n2\t1\t36\t4.0\t0.5\n",
        "Frequency (Hz),Time domain (s),Current (AC) (A),Potential (AC) (V)\n1000,0,-2,4.1\n100,36,0.5,4\n",
    ] {
        holds(text);
    }
    for (text, message) in [
        // Two columns are ambiguous.
        (
            "V,µA,V,µA\n1,2,3,4\n1,2,3,4\n",
            "it names a voltage and a current, and not a time",
        ),
        (
            "s,V,V,A\n0,1,2,3\n1,1,2,3\n",
            "line 1: expected columns of a time",
        ),
        // Units of the names above, one of which is unknown.
        (
            "Time;Voltage;Level\ns;V;A\n0;4.1;-2\n36;4.0;0.5\n",
            "not a current",
        ),
        ("d,V,A\n0,4.1,-2\n1,4.0,0.5\n", "not a time"),
        // Prose.
        (
            "record a voltage over time\nof cells\nand nothing more\n",
            "and not a current",
        ),
    ] {
        let met = read("x.txt", text.as_bytes()).unwrap_err();
        assert!(met.contains(message), "{met}\n{text}");
    }
}

#[test]
fn a_refusal_names_the_line_before_the_rows() {
    for (text, message) in [
        (
            // CH Instruments: the current is in the head.
            "Chronopotentiometry\nCurrent Polarity = Potential\nSegment = 2\n\nTime/sec, Potential/V\n\n\
             0.5, 0.7\n1.0, 0.8\n",
            "line 5: expected columns of a time, a voltage and a current, such as \"Test Time / s,Voltage / \
             V,Current / A\", met \"Time/sec, Potential/V\": it names a time and a voltage, and not a current",
        ),
        (
            "EXPLAIN\nTAG\tSQUAREWAVE\nCONDIT\tTWOPARAM\tF\t15\t0\tConditioning\tTime(s)\tE(V)\n\
             CURVE\tTABLE\t2\n\tPt\tT\tVfwd\tIfwd\n\t#\ts\tV\tA\n\t0\t0.1\t1\t2\n\t1\t0.2\t1\t2\n",
            "line 5: expected",
        ),
        (
            "Cycle_Index,Test_Time (s),Max_Current (A)\n1,10,2\n2,20,2\n",
            "it names a time, and not a voltage and a current",
        ),
        (
            "{\"Time/s\": [1], \"Voltage/V\": [2]}\n",
            "met JSON, which is not read as a table",
        ),
        (
            "<?xml version=\"1.0\"?>\n<a Time Voltage>\n",
            "met XML or HTML",
        ),
    ] {
        let met = read("x.txt", text.as_bytes()).unwrap_err();
        assert!(met.contains(message), "{met}\n{text}");
    }
}

#[test]
fn gamrys_open_circuit_potential_is_a_rest() {
    let text = "EXPLAIN\nTAG\tCORPOT\nCURVE\tTABLE\t2\n\tPt\tT\tVf\tVm\tOver\n\t#\ts\tV vs. Ref.\tV\tbits\n\
                \t0\t0.5\t3.71\t0\t...a\n\t1\t1.0\t3.72\t0\t...a\n";
    let series = read("x.dta", text.as_bytes()).unwrap();
    assert_eq!(
        (series.time_s, series.voltage_v, series.current_a),
        (vec![0.5, 1.0], vec![3.71, 3.72], vec![0.0, 0.0])
    );
    let other = read("x.dta", text.replace("CORPOT", "SQUAREWAVE").as_bytes()).unwrap_err();
    assert!(
        other.contains("line 4") && other.contains("not a current"),
        "{other}"
    );
}

#[test]
fn a_code_page_of_two_bytes_is_reported() {
    // `时间(s),电压(V),电流(A)` in GBK.
    let head = b"\xCA\xB1\xBC\xE4(s),\xB5\xE7\xD1\xB9(V),\xB5\xE7\xC1\xF7(A)\n";
    let text = [head.as_slice(), b"0,4.1,-2\n36,4.0,0.5\n"].concat();
    let met = read("x.csv", &text).unwrap_err();
    assert!(
        met.contains("such as GBK or Shift-JIS; save it as UTF-8"),
        "{met}"
    );
    // A single-byte code page is read.
    let latin = b"Zeit (s),Spannung (V),Strom (A),W\xE4rme\n0,4.1,-2,1\n36,4.0,0.5,1\n";
    assert_eq!(read("x.csv", latin).unwrap().current_a, [2.0, -0.5]);
}

fn recorded(text: &str) -> ReadSeries {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.csv");
    std::fs::write(&path, text).unwrap();
    read_record(&path, &SeriesOptions::default()).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

#[test]
fn columns_of_the_state_are_read_as_fractions() {
    for (names, values) in [
        ("SOC(%)", ["80", "79.5"]),
        ("SOC / %", ["80", "79.5"]),
        ("soc", ["0.8", "0.795"]),
        ("DOD [%]", ["20", "20.5"]),
        ("Depth of Discharge / 1", ["0.2", "0.205"]),
    ] {
        let [a, b] = values;
        let text =
            format!("Test Time / s,Voltage / V,Current / A,{names}\n0,4.1,0,{a}\n36,4.0,-2,{b}\n");
        let soc = recorded(&text).state.soc.unwrap();
        assert!(
            (soc[0] - 0.8).abs() < 1e-9 && (soc[1] - 0.795).abs() < 1e-9,
            "{names}: {soc:?}"
        );
    }
    let odd = "Test Time / s,Voltage / V,Current / A,SOC\n0,4.1,0,8000\n36,4.0,-2,7950\n";
    let read = recorded(odd);
    assert_eq!(read.state.soc, None);
    assert!(read.notes[0].contains("8000"), "{:?}", read.notes);
}

#[test]
fn the_temperature_of_the_chamber_stands_in_for_that_of_the_cell() {
    let of = |names: &str, values: [&str; 2]| {
        let [a, b] = values;
        recorded(&format!(
            "Test Time (s),Voltage (V),Current (A),{names}\n0,4.1,0,{a}\n36,4.0,-2,{b}\n"
        ))
    };
    let both = of("Aux_Temperature(℃)_1,Chamber_Temp_degC", ["26,25", "27,25"]);
    assert_eq!(both.series.temperature_degc, Some(vec![26.0, 27.0]));
    let channels = of("Temp45 [°C],Temp46 [°C]", ["26,30", "27,31"]);
    assert_eq!(channels.series.temperature_degc, Some(vec![26.0, 27.0]));
    let chamber = of("Ambient Temperature / degC", ["25", "25"]);
    assert_eq!(chamber.series.temperature_degc, Some(vec![25.0, 25.0]));
    assert!(chamber.notes.iter().any(|note| note.contains("chamber")));
    let nothing = of(
        "Battery_Temp_degC,Chamber Temperature (C)",
        [",-10", ",-10"],
    );
    assert_eq!(nothing.series.temperature_degc, Some(vec![-10.0, -10.0]));
}

#[test]
fn the_head_of_digatrons_export_has_the_capacity_and_its_steps_are_kept() {
    let text = "\
Measurement ID,585,,
Battery Name,cell 7,,
Nominal Capacity, 3,,
Ambient Temperature, 25,,
Time Stamp,Step,Status,Prog Time,Step Time,Voltage,Current,Capacity,Cnt,
,,,,,[V],[A],[Ah],[Cnt],
11/27/2018 8:41:18 PM,21,PAU,25:19:08.386,00:01:00.004,4.16273,0.00000,0.00000,13.0,
11/27/2018 8:41:19 PM,22,DCH,25:19:09.386,00:00:01.004,4.12273,-1.50000,-0.00042,13.0,
";
    let read = recorded(text);
    let head = read.state.head;
    let of = |fact: Option<Fact>| fact.map(|fact| (fact.value, fact.line));
    assert_eq!(of(head.capacity_ah), Some((3.0, 3)));
    assert_eq!(of(head.temperature_degc), Some((25.0, 4)));
    assert_eq!(read.steps, Some(vec![21.0, 22.0]));
    assert_eq!(read.series.current_a[1], 1.5);
}
