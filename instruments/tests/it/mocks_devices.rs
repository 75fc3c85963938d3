//! Answers of each mock and its actions on its world: exchanges from the instruments'
//! documentation.

use instruments::{
    fixture::Fixture,
    mock::{
        self, MODELS, MockOptions,
        plant::{Action, BipolarState, ChillerState, GeneratorState, LoadState, SupplyState},
    },
};

use crate::mocks_plant::Bench;

const OK: &str = "0,\"No error\"\n";
const UNDEFINED: &str = "-113,\"Undefined header\"\n";

#[test]
fn the_switching_kepco_answers_as_its_manual_has_it() {
    let mut bench = Bench::new("kepco-bop-mg");
    bench.table(&[
        ("*IDN?", "KEPCO,BOP1KW 50-20 ,TEST1, 2.01\n"),
        ("FUNC:MODE?", "0\n"),
        ("FUNC:MODE CURR", ""),
        ("FUNC:MODE?", "1\n"),
        ("CURR -2.5", ""),
        ("CURR?", "-2.5E0\n"),
        ("CURR? MAX", "2.0E1\n"),
        ("curr? min", "-2.0E1\n"),
        ("SOUR:CURR:LEV:IMM:AMPL 1500 mA", ""),
        ("CURR?", "1.5E0\n"),
        ("CURR 20.5", ""),
        ("SYST:ERR?", "-222,\"Data out of range\"\n"),
        ("SYST:ERR?", OK),
        ("CURR?", "1.5E0\n"),
        ("CURR:LIM 5;:CURR 6", ""),
        ("SYST:ERR?", "-222,\"Data out of range\"\n"),
        ("CURR:LIM:BOTH?", "5.0E0, -5.0E0\n"),
        ("CURR:LIM:NEG 3", ""),
        ("CURR:LIM?", "5.0E0, -3.0E0\n"),
        ("CURR? MIN", "-3.0E0\n"),
        ("CURR 3;:CURR:LIM 2;:CURR?", "2.0E0\n"), // a new limit takes the set-point along
        ("VOLT:PROT:POS 4.25", ""),
        ("VOLT:PROT:POS?", "4.25E0\n"),
        ("VOLT:PROT 60", ""),
        ("SYST:ERR?", "-222,\"Data out of range\"\n"),
        ("CURR:PROT:MODE LESS", ""),
        ("CURR:PROT:MODE?", "LESS\n"),
        ("CURR:MODE?", "FIX\n"),
        ("CURR:MODE EXT", ""),
        ("VOLT:MODE?", "EXT\n"),
        ("OUTP:MODE BATTERY", ""),
        ("OUTP:MODE?", "BATTERY\n"),
        ("OUTP:CONT HIGH;:OUTP ON", ""),
        ("SYST:ERR?", "-221,\"Settings conflict\"\n"),
        ("OUTP:CONT OFF;CONT?", "OFF\n"),
        ("OUTP?", "0\n"),
        ("OUTP ON", ""),
        ("OUTP?", "1\n"),
        ("MEAS:VOLT?;CURR?", "3.75E0;-2.5E0\n"),
        ("MEAS:SCAL:CURR:DC?", "-2.5E0\n"),
        ("MEM:UPD LIM", ""),
        ("SYST:REM ON", ""),
        ("*OPC?", "1\n"),
        ("SYST:ERR:NEXT?", OK),
    ]);
}

#[test]
fn the_kepco_queues_errors_and_drops_half_answers() {
    let mut bench = Bench::new("kepco-bop-mg");
    bench.table(&[
        ("*IDN?;NONSENSE?", ""),
        ("SYST:ERR?", UNDEFINED),
        (" *IDN?\r", "KEPCO,BOP1KW 50-20 ,TEST1, 2.01\n"),
        ("VOLT", ""),
        ("SYST:ERR?", "-109,\"Missing parameter\"\n"),
        ("VOLT 1,2", ""),
        ("SYST:ERR?", "-108,\"Parameter not allowed\"\n"),
        ("VOLT 1 A", ""),
        ("SYST:ERR?", "-131,\"Invalid suffix\"\n"),
        ("*OPC", ""),
        ("*ESR?", "161\n"), // power on, command error, operation complete
        ("SYST:ERR?", OK),
        ("volt 10345.2e-1", ""), // the manual's own example of lost digits
        ("VOLT?", "3.452E1\n"),
    ]);
    for _ in 0..20 {
        bench.send(&["BAD"]);
    }
    for _ in 0..14 {
        assert_eq!(bench.ask("SYST:ERR?"), UNDEFINED);
    }
    bench.table(&[
        ("SYST:ERR?", "-350,\"Queue overflow\"\n"),
        ("SYST:ERR?", OK),
        ("BAD", ""),
        ("*CLS", ""),
        ("SYST:ERR?", OK),
    ]);
    let long = format!("VOLT 1{}", " ".repeat(250));
    bench.send(&[&long]);
    assert!(bench.ask("SYST:ERR?").starts_with("-363,"));
}

#[test]
fn the_kepco_moves_the_world() {
    let off = BipolarState {
        off_is_open: true,
        ..BipolarState::default()
    };
    assert_eq!(
        Bench::new("kepco-bop-mg").last_action(),
        Action::Bipolar(off)
    );
    let mut bench = Bench::with("kepco-bop-mg", &MockOptions::quirk("off_active", true));
    assert_eq!(
        bench.last_action(),
        Action::Bipolar(BipolarState::default())
    );
    bench.send(&[
        "OUTP:MODE BATT",
        "FUNC:MODE CURR",
        "VOLT 4.3",
        "CURR 1.25",
        "OUTP 1",
    ]);
    let on = BipolarState {
        output_on: true,
        current_mode: true,
        setpoint: 1.25,
        limit: 4.3,
        ..off
    };
    assert_eq!(bench.last_action(), Action::Bipolar(on));
    bench.send(&["CURR:MODE EXT"]);
    assert_eq!(
        bench.last_action(),
        Action::Bipolar(BipolarState {
            analog_input: true,
            ..on
        })
    );
    bench.send(&["VOLT:PROT 4.2"]);
    assert_eq!(
        bench.last_action(),
        Action::Bipolar(BipolarState {
            analog_input: true,
            limit: 4.2,
            ..on
        })
    );
    bench.send(&["*RST"]);
    assert_eq!(bench.last_action(), Action::Bipolar(off));
}

#[test]
fn the_linear_kepco_lacks_what_its_wiring_does() {
    let mut bench = Bench::new("kepco-bop-linear");
    bench.table(&[
        ("*IDN?", "KEPCO,BOP 20-20,TEST1,2.6\n"),
        ("FUNC:MODE CURR;:OUTP ON", ""),
    ]);
    for missing in [
        "CURR:MODE EXT",
        "CURR:MODE?",
        "OUTP:MODE BATTERY",
        "OUTP:CONT OFF",
        "CURR:PROT:MODE FIX",
    ] {
        bench.table(&[(missing, ""), ("SYST:ERR?", UNDEFINED)]);
    }
    let wired = |bench: &Bench| {
        matches!(
            bench.last_action(),
            Action::Bipolar(BipolarState {
                output_on: true,
                analog_input: true,
                ..
            })
        )
    };
    assert!(wired(&bench));
    let mut bench = Bench::with(
        "kepco-bop-linear",
        &MockOptions::quirk("analog_wired", false),
    );
    bench.send(&["FUNC:MODE CURR", "OUTP ON"]);
    assert!(!wired(&bench));
}

#[test]
fn the_generator_speaks_in_keyword_lists() {
    let mut bench = Bench::new("siglent-sdg1000x");
    bench.table(&[
        ("*IDN?", "Siglent Technologies,SDG1032X,TEST1,1.01.01.33R1B6\n"),
        ("C1:OUTP?", "C1:OUTP OFF,LOAD,HZ,PLRT,NOR\n"),
        ("C1:BSWV WVTP,SINE,FRQ,1000,AMP,1,OFST,0,PHSE,0", ""),
        (
            "C1:BSWV?",
            "C1:BSWV WVTP,SINE,FRQ,1000HZ,PERI,0.001S,AMP,1V,AMPVRMS,0.3536Vrms,MAX_OUTPUT_AMP,20V,\
            OFST,0V,HLEV,0.5V,LLEV,-0.5V,PHSE,0\n",
        ),
        ("C1:OUTP LOAD,50", ""),
        (
            "C1:BSWV?",
            "C1:BSWV WVTP,SINE,FRQ,1000HZ,PERI,0.001S,AMP,0.5V,AMPVRMS,0.1768Vrms,MAX_OUTPUT_AMP,10V,\
            OFST,0V,HLEV,0.25V,LLEV,-0.25V,PHSE,0\n",
        ),
        ("C1:OUTP ON,LOAD,HZ,PLRT,INVT", ""),
        ("C1:OUTP?", "C1:OUTP ON,LOAD,HZ,PLRT,INVT\n"),
        ("C1:OUTPut?", "C1:OUTP ON,LOAD,HZ,PLRT,INVT\n"), // long forms are understood, short ones answered
        ("C2:OUTP?", "C2:OUTP OFF,LOAD,HZ,PLRT,NOR\n"),
        ("C1:BSWV FRQ,0.1HZ,AMP,99,MAX_OUTPUT_AMP,4V", ""), // clamped without a word
        (
            "C1:BSWV?",
            "C1:BSWV WVTP,SINE,FRQ,0.1HZ,PERI,10S,AMP,4V,AMPVRMS,1.414Vrms,MAX_OUTPUT_AMP,4V,\
            OFST,0V,HLEV,2V,LLEV,-2V,PHSE,0\n",
        ),
        ("C1:BSWV WVTP,DC,OFST,-0.28", ""),
        ("C1:BSWV?", "C1:BSWV WVTP,DC,MAX_OUTPUT_AMP,4V,OFST,-0.28V\n"),
        ("C1:BSWV? FRQ", ""), // a query of one field does not exist
        ("CHDR?", ""),
        ("NONSENSE?", ""),
        ("C1:BTWV?", "C1:BTWV STATE,OFF\n"),
        ("SYST:ERR?", "0,No Error\n"),
        ("*OPC?", "1\n"),
    ]);
}

#[test]
fn the_generator_drives_the_world_and_restarts_its_phase_on_a_new_frequency() {
    let mut bench = Bench::new("siglent-sdg1000x");
    let state = |bench: &Bench| match bench.last_action() {
        Action::Generator(state) => state,
        other => panic!("{other:?}"),
    };
    bench.send(&[
        "C1:OUTP LOAD,HZ",
        "C1:BSWV WVTP,SINE,FRQ,10,AMP,2.09,OFST,-0.28,PHSE,90",
    ]);
    assert_eq!(state(&bench), GeneratorState::default());
    bench.now_s = 5.0;
    bench.send(&["C1:OUTP ON"]);
    let phase_rad = std::f64::consts::FRAC_PI_2;
    let on = GeneratorState {
        offset_v: -0.28,
        amplitude_v: 1.045,
        freq_hz: 10.0,
        phase_rad,
        since_s: 5.0,
        periods: None,
    };
    assert_eq!(state(&bench), on);
    bench.now_s = 6.0;
    bench.send(&["C1:BSWV AMP,1"]);
    assert_eq!(
        state(&bench),
        GeneratorState {
            amplitude_v: 0.5,
            ..on
        }
    );
    bench.now_s = 7.0;
    bench.send(&["C1:BSWV FRQ,20"]);
    assert_eq!(
        state(&bench),
        GeneratorState {
            amplitude_v: 0.5,
            freq_hz: 20.0,
            since_s: 7.0,
            ..on
        }
    );
    // With its load set to 50 Ω, the generator outputs twice the set voltage at an open end.
    bench.send(&["C1:OUTP LOAD,50", "C1:BSWV AMP,1"]);
    assert_eq!(state(&bench).amplitude_v, 1.0);
    bench.send(&["C2:OUTP ON", "C1:OUTP OFF"]);
    assert_eq!(state(&bench), GeneratorState::default());
    bench.send(&["C1:BSWV WVTP,DC,OFST,1", "C1:OUTP ON,LOAD,HZ"]);
    assert_eq!(state(&bench).amplitude_v, 0.0);
}

#[test]
fn a_generator_plays_as_many_periods_as_it_was_set_to_and_waits_for_its_trigger() {
    for (model, set, count, fire, elsewhere) in [
        (
            "siglent-sdg1000x",
            "C1:BSWV WVTP,SINE,FRQ,10,AMP,2",
            "C1:BTWV STATE,ON,GATE_NCYC,NCYC,TRSR,MAN,TIME,30",
            "C1:BTWV MTRIG",
            "C1:BTWV STPS,90,DLAY,0.25",
        ),
        (
            "keysight-33500b",
            "SOUR1:FREQ 10",
            "TRIG1:SOUR BUS;:SOUR1:BURS:MODE TRIG;NCYC 30;STAT ON",
            "TRIG1",
            "SOUR1:BURS:PHAS 90;:TRIG1:DEL 0.25",
        ),
    ] {
        let mut bench = Bench::new(model);
        let periods = |bench: &Bench| match bench.last_action() {
            // An SDG begins a quarter of a microsecond after its trigger.
            Action::Generator(state) => (state.periods, (1.0e6 * state.since_s).round() / 1.0e6),
            other => panic!("{other:?}"),
        };
        bench.send(&[
            set,
            if model.starts_with("siglent") {
                "C1:OUTP ON"
            } else {
                "OUTP1 ON"
            },
        ]);
        assert_eq!(periods(&bench).0, None, "{model}");
        bench.now_s = 2.0;
        bench.send(&[count]);
        assert_eq!(periods(&bench).0, Some(0), "{model}");
        bench.now_s = 3.0;
        bench.send(&[fire]);
        assert_eq!(periods(&bench), (Some(30), 3.0), "{model}");
        // One that is in work is not restarted, one that is over is.
        bench.now_s = 5.9;
        bench.send(&[fire]);
        assert_eq!(periods(&bench), (Some(30), 3.0), "{model}");
        bench.now_s = 6.1;
        bench.send(&[fire]);
        assert_eq!(periods(&bench), (Some(30), 6.1), "{model}");
        // It may begin elsewhere in its period, and later.
        bench.send(&[elsewhere]);
        bench.now_s = 9.5;
        bench.send(&[fire]);
        assert_eq!(periods(&bench), (Some(30), 9.75), "{model}");
        let Action::Generator(state) = bench.last_action() else {
            panic!("{model}")
        };
        assert!(
            (state.phase_rad - std::f64::consts::FRAC_PI_2).abs() < 1.0e-12,
            "{model}: {}",
            state.phase_rad
        );
    }
}

#[test]
fn the_load_answers_and_draws() {
    let mut bench = Bench::new("siglent-sdl1000x");
    bench.table(&[
        ("*IDN?", "Siglent Technologies,SDL1020X-E,TEST1,1.1.1.22\n"),
        (":FUNC CURR", ""),
        (":FUNC?", "CURRENT\n"),
        (":FUNC:MODE?", "BASIC\n"),
        (":CURR:IRANG 6", ""),
        (":CURR:IRANG?", "30\n"),
        (":CURR:IRANG 5", ""),
        (":CURR:IRANG?;VRANG?", "5;150\n"),
        (":CURR:VRANG 36;VRANG?", "36\n"),
        (":CURR:LEV:IMM 1.5", ""),
        (":SOUR:CURR:LEV:IMM?", "1.500000\n"),
        (":CURR 7", ""), // beyond the range: clamped
        (":CURR?", "5.000000\n"),
        (":CURR? MAX", "5.000000\n"),
        (":VOLT:LEV:ON 3.0", ""),
        (":VOLT:LEV:ON?", "3.000000\n"),
        (":CURR:PROT:LEV 6;STAT ON;DEL 1", ""),
        (":CURR:PROT:STAT?", "1\n"),
        (":INP?", "0\n"),
        (":SOUR:INP:STAT 1", ""),
        (":INP?", "1\n"),
        (":CURR:IRANG 30;IRANG?", "5\n"), // not while the input is on
        ("MEAS:VOLT?", "3.700000\n"),
        ("MEAS:CURR?", "1.500000\n"),
        ("MEAS:POW?", "5.550000\n"),
        ("SYST:SENS ON", ""),
        ("SYST:SENS?", "1\n"),
        ("SYST:ERR?", ""), // there is none
        (":NONSENSE?", ""),
        ("*OPC?", "1\n"),
    ]);
    let drawing = LoadState {
        input_on: true,
        current_a: 5.0,
        min_voltage_v: 3.0,
        power_w: None,
    };
    assert_eq!(bench.last_action(), Action::Load(drawing));
    bench.send(&[":CURR:PROT:LEV 4"]);
    bench.now_s = 2.0;
    assert_eq!(bench.ask(":INP?"), "0\n");
    assert_eq!(
        bench.last_action(),
        Action::Load(LoadState {
            input_on: false,
            ..drawing
        })
    );
    // A latching load that has started continues below its start voltage.
    bench.send(&[":CURR 1", ":VOLT:LATC ON", ":INP ON"]);
    assert_eq!(
        bench.last_action(),
        Action::Load(LoadState {
            input_on: true,
            current_a: 1.0,
            min_voltage_v: 0.0,
            power_w: None
        })
    );
    bench.send(&[":FUNC POW"]);
    assert!(matches!(
        bench.last_action(),
        Action::Load(LoadState {
            current_a: 0.0,
            power_w: Some(0.0),
            ..
        })
    ));
    bench.send(&[":POW:LEV:IMM 12.5"]);
    assert!(matches!(
        bench.last_action(),
        Action::Load(LoadState {
            input_on: true,
            current_a: 0.0,
            power_w: Some(12.5),
            ..
        })
    ));
}

#[test]
fn the_supply_has_no_output_query_but_a_status_word() {
    let mut bench = Bench::new("siglent-spd3303x");
    bench.table(&[
        (
            "*IDN?",
            "Siglent Technologies,SPD3303X,TEST1,1.01.01.02.07R2,V3.0\n",
        ),
        ("CH1:VOLT 4.2", ""),
        ("CH1:VOLT?", "4.200\n"),
        ("CH1:CURR 3", ""),
        ("CH1:CURR?", "3.000\n"),
        ("SYST:STAT?", "0x0004\n"),
        ("OUTP CH1,ON", ""),
        ("SYST:STAT?", "0x0014\n"),
        ("CH1:CURR 1.25", ""), // what flows: it limits
        ("SYST:STAT?", "0x0015\n"),
        ("OUTP CH2,ON", ""),
        ("SYST:STAT?", "0x0035\n"),
        ("MEAS:VOLT? CH1", "4.000\n"),
        ("MEAS:CURR? CH1", "1.250\n"),
        ("MEAS:POWE? CH1", "5.000\n"),
        ("INST CH2", ""),
        ("INST?", "CH2\n"),
        ("SYST:ERR?", "0  No Error\n"),
        ("OUTP? CH1", ""),
        ("SYST:ERR?", "-113  Undefined header\n"),
        ("OUTP:TRACK 0", ""),
    ]);
    let before = bench.plant.lock().unwrap().actions.clone();
    assert!(before.iter().any(|(_, action)| *action
        == Action::Supply(SupplyState {
            output_on: true,
            voltage_v: 4.2,
            current_a: 1.25
        })));
    bench.send(&["OUTP CH1,OFF"]);
    assert!(matches!(
        bench.last_action(),
        Action::Supply(SupplyState {
            output_on: false,
            ..
        })
    ));
}

#[test]
fn the_chiller_writes_in_silence_and_obeys_only_in_remote_mode() {
    let mut bench = Bench::new("julabo");
    bench.table(&[
        ("VERSION", "JULABO CRYOCOMPACT CF31 VERSION 5.0\r\n"),
        ("STATUS", "02 REMOTE STOP\r\n"),
        ("OUT_SP_00 12.5", ""),
        ("IN_SP_00", "12.50\r\n"),
        ("out_mode_05 1", ""),
        ("in_mode_05", "1\r\n"),
        ("STATUS", "03 REMOTE START\r\n"),
        ("IN_PV_00", "24.50\r\n"),
        ("IN_PV_02", "---.--\r\n"),
        ("OUT_SP_00 900", ""),
        ("STATUS", "-11 VALUE TOO LARGE\r\n"),
        ("OUT_SP_00 -90", ""),
        ("STATUS", "-10 VALUE TOO SMALL\r\n"),
        ("IN_SP_00", "12.50\r\n"),
        ("NONSENSE", ""),
        ("STATUS", "-08 INVALID COMMAND\r\n"),
    ]);
    assert_eq!(
        bench.last_action(),
        Action::Chiller(ChillerState {
            running: true,
            setpoint_degc: 12.5
        })
    );
    let mut bench = Bench::with("julabo", &MockOptions::quirk("local", true));
    bench.table(&[
        ("STATUS", "00 MANUAL STOP\r\n"),
        ("OUT_SP_00 12.5", ""),
        ("OUT_MODE_05 1", ""),
        ("IN_SP_00", "25.00\r\n"),
        ("STATUS", "00 MANUAL STOP\r\n"),
    ]);
    let mut bench = Bench::with("julabo", &MockOptions::quirk("strict_pacing", true));
    bench.table(&[
        ("OUT_SP_00 12.5", ""),
        ("OUT_MODE_05 1", ""),
        ("IN_MODE_05", ""),
    ]);
    bench.now_s = 0.25;
    bench.table(&[("IN_MODE_05", "0\r\n"), ("IN_SP_00", "12.50\r\n")]);
}

#[test]
fn the_logger_scans_its_list() {
    let mut bench = Bench::new("keysight-34970a");
    bench.table(&[
        ("*IDN?", "HEWLETT-PACKARD,34970A,0,13-2-2\n"),
        ("READ?", ""),
        ("SYST:ERR?", "-221,\"Settings conflict\"\n"),
        ("CONF:TEMP TC,K,(@101:104)", ""),
        ("UNIT:TEMP C,(@101:104)", ""),
        (
            "READ?",
            "+2.53740000E+01,+2.20000000E+01,+2.45000000E+01,+9.90000000E+37\n",
        ),
        ("ROUT:SCAN (@102,101)", ""),
        ("ROUT:SCAN?", "#210(@102,101)\n"),
        ("FETC?", ""),
        ("SYST:ERR?", "-230,\"Data corrupt or stale\"\n"),
        ("TRIG:SOUR IMM;COUN 1", ""),
        ("INIT", ""),
        ("DATA:POIN?", "2\n"),
        ("FETC?", "+2.20000000E+01,+2.53740000E+01\n"),
        ("R? 1", "#215+2.20000000E+01\n"),
        ("DATA:POIN?", "1\n"),
        ("FORM:READ:UNIT ON;CHAN ON", ""),
        ("READ?", "+2.20000000E+01 C,102,+2.53740000E+01 C,101\n"),
        ("ROUT:MON (@103);MON:DATA?", "+2.45000000E+01 C,103\n"),
        ("ROUT:SCAN (@201)", ""),
        ("SYST:ERR?", "-222,\"Data out of range\"\n"),
        ("SYST:ERR?", "+0,\"No error\"\n"),
    ]);
}

#[test]
fn the_jig_changes_fixtures() {
    let mut bench = Bench::new("mock-jig");
    for (word, answer, fixture) in [
        ("SHUNT", "SHUNT\n", Fixture::Shunt),
        ("fake", "FAKE\n", Fixture::FakeCell),
        ("CELL", "CELL\n", Fixture::Cell),
    ] {
        bench.send(&[&format!("JIG:MOUN {word}")]);
        assert_eq!(bench.ask("JIG:MOUNt?"), answer);
        assert_eq!(bench.plant.lock().unwrap().fixture, Some(fixture));
    }
    bench.table(&[
        ("JIG:MOUN BANANA", ""),
        ("SYST:ERR?", "-224,\"Illegal parameter value\"\n"),
    ]);
    assert!(bench.ask("*IDN?").starts_with("eis-bench,mock-jig,TEST1,"));
}

#[test]
fn the_jig_takes_only_the_cells_that_there_are() {
    let mut bench = Bench::new("mock-jig");
    bench.table(&[
        ("JIG:CELL?", "1\n"),
        ("JIG:CELL 1", ""),
        ("SYST:ERR?", "0,\"No error\"\n"),
    ]);
    for none in ["2", "0", "1.5", "-1"] {
        bench.table(&[
            (&format!("JIG:CELL {none}"), ""),
            ("SYST:ERR?", "-222,\"Data out of range\"\n"),
        ]);
    }
    bench.table(&[("JIG:CELL?", "1\n")]);
}

#[test]
fn an_unknown_model_is_named_with_the_known_ones() {
    let plant = Bench::new("mock-jig").plant;
    let message = mock::make("teapot", plant, &MockOptions::default())
        .err()
        .unwrap()
        .to_string();
    assert!(
        message.starts_with("expected a model that can be simulated (kepco-bop-mg, ")
            && message.ends_with("found `teapot`"),
        "{message}"
    );
}

#[test]
fn echo_comes_before_the_answer() {
    let mut bench = Bench::with("kepco-bop-mg", &MockOptions::quirk("echo", true));
    assert_eq!(bench.ask("OUTP?"), "OUTP?\r\n0\n");
}

/// Connecting and asking must not move anything: no query acts on the world.
#[test]
fn queries_change_nothing() {
    let queries = [
        "*IDN?",
        "OUTP?",
        "CURR?",
        "C1:BSWV?",
        ":INP?",
        "MEAS:VOLT?",
        "SYST:STAT?",
        "IN_SP_00",
        "STATUS",
        "SYST:ERR?",
        "NONSENSE?",
    ];
    for model in MODELS {
        let mut bench = Bench::new(model.key);
        let before = bench.plant.lock().unwrap().actions.len();
        for query in queries {
            bench.ask(query);
        }
        assert_eq!(
            bench.plant.lock().unwrap().actions.len(),
            before,
            "{}",
            model.key
        );
    }
}
