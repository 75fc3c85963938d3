//! Test files of pyimpspec, impedance.py and PyEIS, if available: they must be read correctly or
//! refused by their format. `tests/external/formats` compares their numbers with the readings of
//! those programs.

use super::parse_file;
use std::path::Path;

#[test]
fn files_of_peers_are_read_whole_or_refused() {
    let folder = Path::new(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../../shared/data/formats"
    ));
    if !folder.is_dir() {
        eprintln!("files of peers: skipped, not available");
        return;
    }
    let first = 109.009_182_194_390_28;
    let three: &[usize] = &[29, 29, 29];
    for (name, counts, z_re_ohm) in [
        ("pyimpspec/case-multiple-spectra.mpt", three, 109.009_18),
        ("pyimpspec/case-multiple-spectra.csv", &[29; 4], first),
        (
            "pyimpspec/case-multiple-spectra-reverse.csv",
            &[29; 2],
            first,
        ),
        ("pyimpspec/case-negative-real-imaginary.csv", &[29], first),
        ("pyimpspec/case-fragment.csv", &[6], 112.057_759_954_682_18),
        ("pyimpspec/data-header-variant-3.csv", &[29], first),
        ("pyimpspec/data-header-variant-4.csv", &[29], first),
        ("pyimpspec/data-tab.csv", &[29], first),
        ("pyimpspec/data-space.csv", &[29], first),
        ("pyimpspec/data-comma-decimal-separator.csv", &[29], first),
        ("pyimpspec/drift-corrected-data.dta", &[55, 55], 691.688_7),
        ("pyimpspec/data.P00", &[29], 109.0),
        ("pyimpspec/data.dfr", &[29], first),
        ("pyimpspec/data-dfr", &[29], first),
        ("pyimpspec/data.i2b", &[29], first),
        ("pyimpspec/data-i2b", &[29], first),
        ("pyimpspec/data.ids", &[29, 29], 109.009),
        ("pyimpspec/data-ids", &[29, 29], 109.009),
        ("pyimpspec/data.idf", &[29], 109.009),
        ("pyimpspec/data.xlsx", &[29; 4], first),
        ("pyimpspec/data-xlsx", &[29; 4], first),
        ("pyimpspec/data.ods", &[29; 4], first),
        ("pyimpspec/data-ods", &[29; 4], first),
        ("pyimpspec/data.fods", &[29; 4], first),
        ("pyimpspec/data.pssession", &[29], 109.009_182_194_39),
        ("impedance_py/exampleDataCHInstruments.txt", &[73], 98.91),
        (
            "impedance_py/exampleDataParstat.txt",
            &[31],
            -0.000_498_162_803_761_04,
        ),
        ("impedance_py/exampleDataPowersuite.txt", &[30], -470.541_13),
        ("impedance_py/exampleDataVersaStudio.par", &[61], 55.315_71),
        ("impedance_py/exampleDataGamryABORT.DTA", &[72], 825.858_4),
        ("impedance_py/exampleDataZPlot_noComments.z", &[31], 642.62),
        ("pyeis/ex1.mpt", &[59, 59], 428.905_58),
    ] {
        let bytes = std::fs::read(folder.join(name)).unwrap();
        let read = parse_file(Path::new(name), &bytes).unwrap_or_else(|error| panic!("{error}"));
        let met: Vec<usize> = read
            .spectra
            .iter()
            .map(|s| s.spectrum.points.len())
            .collect();
        let fastest = read.spectra[0].spectrum.points.last().unwrap().z_ohm.re;
        assert!(
            met == counts && (fastest / z_re_ohm - 1.0).abs() < 1e-9,
            "{name}: {met:?} {fastest}"
        );
        assert_eq!(
            read.spectra.len() > 1,
            read.notes
                .iter()
                .any(|note| note.contains("spectra, separated")),
            "{name}: {:?}",
            read.notes
        );
    }
    for (name, message) in [
        ("pyimpspec/data.json", "JSON"),
        (
            "impedance_py/exampleDataBioLogic_MissingFreq.mpt",
            "expected a column of the frequency",
        ),
    ] {
        let bytes = std::fs::read(folder.join(name)).unwrap();
        let refused = parse_file(Path::new(name), &bytes).unwrap_err().to_string();
        assert!(
            refused.starts_with(name) && refused.contains(message),
            "{refused}"
        );
    }
}
