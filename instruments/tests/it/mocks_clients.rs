//! Queries of common clients: the mocks answer them as the guides state.

use std::sync::{Arc, Mutex};

use instruments::mock::{self, Device, Latency, MockOptions};

use crate::{
    drivers_common::{Rig, in_virtual_time},
    mocks_plant::Recorder,
};

fn device(model: &str) -> Box<dyn Device> {
    let plant = Arc::new(Mutex::new(Recorder::default()));
    mock::make(model, plant, &MockOptions::default()).unwrap()
}

fn ask(device: &mut dyn Device, message: &str) -> String {
    let reply = device.handle(1.0, message.as_bytes());
    String::from_utf8_lossy(&reply).trim_end().to_owned()
}

/// The queries of PyMeasure's own tests of the SDS1000X HD, as it sends them.
const SDS_QUERIES: &[&str] = &[
    ":CHANnel1:SCALe?",
    ":CHANnel1:COUPling?",
    ":CHANnel1:PROBe?",
    ":CHANnel1:OFFSet?",
    ":CHANnel1:VISible?",
    ":CHANnel1:SWITch?",
    ":CHANnel1:BWLimit?",
    ":CHANnel1:INVert?",
    ":CHANnel1:UNIT?",
    ":WAVeform:SOURce?",
    ":WAVeform:STARt?",
    ":WAVeform:POINt?",
    ":WAVeform:WIDTh?",
    ":WAVeform:INTerval?",
    ":WAVeform:MAXPoint?",
    ":ACQuire:AMODe?",
    ":ACQuire:INT?",
    ":ACQuire:MMANagement?",
    ":ACQuire:MODE?",
    ":ACQuire:MDEPth?",
    ":ACQuire:POINts?",
    ":ACQuire:RESolution?",
    ":ACQuire:SEQuence?",
    ":ACQuire:SRATe?",
    ":ACQuire:TYPE?",
    ":TIMebase:SCALe?",
    ":TIMebase:DELay?",
    ":TIMebase:REFerence?",
    ":TIMebase:REFerence:POSition?",
    ":TIMebase:WINDow?",
    ":TIMebase:WINDow:DELay?",
    ":TIMebase:WINDow:SCALe?",
    ":TRIGger:FREQuency?",
    ":TRIGger:MODE?",
    ":TRIGger:STATus?",
    ":TRIGger:TYPE?",
    ":TRIGger:EDGE:COUPling?",
    ":TRIGger:EDGE:LEVel?",
    ":TRIGger:EDGE:SLOPe?",
    ":TRIGger:EDGE:SOURce?",
    ":TRIGger:EDGE:NREJect?",
    ":TRIGger:EDGE:IMPedance?",
    ":TRIGger:EDGE:HLDEVent?",
    ":TRIGger:EDGE:HLDTime?",
    ":TRIGger:EDGE:HOLDoff?",
    ":TRIGger:EDGE:HSTart?",
    ":MEASure?",
    ":MEASure:MODE?",
    ":MEASure:ADVanced:LINenumber?",
    ":MEASure:ADVanced:STATistics?",
    ":MEASure:SIMPle:SOURce?",
    ":MEASure:SIMPle:VALue? ALL",
    ":MEASure:ADVanced:P1?",
    ":MEASure:ADVanced:P1:SOURce1?",
    ":MEASure:ADVanced:P1:SOURce2?",
    ":MEASure:ADVanced:P1:STATistics? CURRent",
    ":MEASure:ADVanced:P1:TYPE?",
    ":MEASure:ADVanced:P1:VALue?",
    ":MEASure:ADVanced:P12?",
    ":MEASure:ADVanced:P5:SOURce1?",
];

#[test]
fn a_scope_answers_the_queries_of_pymeasure_and_keeps_what_it_was_set_to() {
    let mut scope = device("siglent-sds800x-hd");
    let silent: Vec<&&str> = SDS_QUERIES
        .iter()
        .filter(|query| ask(scope.as_mut(), query).is_empty())
        .collect();
    assert_eq!(silent, [&""; 0], "of {}", SDS_QUERIES.len());
    for (set, query, answer) in [
        (":ACQuire:AMODe SLOW", ":ACQuire:AMODe?", "SLOW"),
        (":ACQuire:MODE XY", ":ACQuire:MODE?", "XY"),
        (":TRIGger:EDGE:COUPling AC", ":TRIGger:EDGE:COUPling?", "AC"),
        (
            ":MEASure:ADVanced:P5:SOURce1 C4",
            ":MEASure:ADVanced:P5:SOURce1?",
            "C4",
        ),
        // What the simulation would have to show is refused instead of stored.
        (":CHANnel1:INVert ON", ":CHANnel1:INVert?", "OFF"),
    ] {
        assert_eq!(ask(scope.as_mut(), set), "");
        assert_eq!(ask(scope.as_mut(), query), answer, "{set}");
    }
}

#[test]
fn optional_nodes_channels_and_bounds_are_as_the_guides_have_them() {
    for (model, messages) in [
        (
            "rigol-dp832",
            &[
                (":INST CH1", ""),
                (":OUTP:STAT ON", ""),
                (":OUTP? CH1", "ON"),
                (":OUTP OFF", ""),
                (":OUTP? CH1", "OFF"),
                (":SOUR1:VOLT? MAX", "32.000"),
                (":SOUR1:CURR? MIN", "0.000"),
                (":SYST:VERS?", "1999.0"),
            ][..],
        ),
        (
            "keysight-33500b",
            &[
                ("FREQ 1234", ""),
                ("SOUR1:FREQ?", "+1.234000000000000E+03"),
                ("FREQ?", "+1.234000000000000E+03"),
                ("SOURce:VOLT:OFFS 0.1", ""),
                ("VOLT:OFFS?", "+1.000000000000000E-01"),
                ("BURS:STAT?", "0"),
                ("SYST:VERS?", "1999.0"),
            ],
        ),
        (
            "rigol-dl3000",
            &[(":SYST:VERS?", "1999.0"), ("*STB?", "0"), ("*ESE?", "0")],
        ),
        (
            "keysight-e36312a",
            &[("SYST:VERS?", "1999.0"), ("*SRE 4;*SRE?", "4")],
        ),
        (
            "rigol-dho800",
            &[(":SYST:VERS?", "1999.0"), (":SYST:ERR?", "0,\"No error\"")],
        ),
        (
            "siglent-sds800x-hd",
            &[("*ESE 1;*ESE?", "1"), ("*STB?", "0"), ("*OPC?", "1")],
        ),
        (
            "kepco-bop-mg",
            &[
                ("CURR? MAX", "2.0E1"),
                ("SYST:VERS?", "1997.0"),
                ("SYST:REM?", "0"),
            ],
        ),
        ("keysight-34970a", &[("SYST:VERS?", "1994.0")]),
    ] {
        let mut device = device(model);
        for (message, answer) in messages {
            assert_eq!(ask(device.as_mut(), message), *answer, "{model}: {message}");
        }
    }
}

#[test]
fn answers_take_the_time_that_owners_measured_if_it_is_asked_for() {
    in_virtual_time(async |clock| {
        for (latency, query_s) in [("none", 0.0), ("measured", 0.028)] {
            let options = MockOptions::quirk("latency", latency);
            let rig = Rig::with(clock.clone(), "rigol-dho800", &options, &[]);
            let start_s = clock.now_s();
            rig.ask(":TRIG:STAT?").await;
            let took_s = clock.now_s() - start_s;
            assert!((took_s - query_s).abs() < 1.0e-6, "{latency}: {took_s} s");
        }
        assert_eq!(Latency::of("siglent-sdl1000x"), None, "no figure, no guess");
    });
}
