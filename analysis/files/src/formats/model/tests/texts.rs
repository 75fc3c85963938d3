//! Files that no compiler of this machine takes: their numbers, names and archives.

use std::io::{Cursor, Read as _};

use super::*;

/// A cell without branches.
fn bare() -> CellModel {
    let mut bare = cell();
    bare.erm.branches.clear();
    bare
}

#[test]
fn tables_for_simscape_hold_the_map() {
    let bent = mapped()
        .text(ModelFormat::Simscape)
        .unwrap_err()
        .to_string();
    assert!(
        bent.contains("expected resistances that do not depend on the current"),
        "{bent}"
    );
    let mut straight = mapped();
    straight.map.as_mut().unwrap().charge_transfer = None;
    let text = straight.text(ModelFormat::Simscape).unwrap();
    for wanted in [
        "map_soc = [    0.1, 0.5, 1.0];",
        "map_K = [    0.0, 25.0] + 273.15;",
        "T_range_K = [253.14999999999998, 318.15];",
        "R2_mat = R_mat(:, :, 3);\ntau2_mat = 60.0 * ones(size(R0_mat));",
        "thermal_mass = 60.0;",
        "% note: off by  / 1 %",
    ] {
        assert!(text.contains(wanted), "{wanted}\n{text}");
    }
    // A number list goes on over lines, and no mark is left; functions without a name begin with `@(`.
    assert!(text.contains(", ...\n") && !text.replace("@(", "").contains('@'));
    let point = bare().text(ModelFormat::Simscape).unwrap();
    assert!(point.contains("activation_K = [    0.0];") && !point.contains("R1_mat = "));
    assert!(point.contains("T_step_K = 20.0;"));
}

#[test]
fn a_modelica_package_has_all_branches() {
    let text = mapped().text(ModelFormat::Modelica).unwrap();
    for wanted in [
        "package a__cell____ \"Model of a lithium-ion cell: a  cell   /\"",
        "constant Integer n_rc = 2",
        "constant Real tau_s[n_rc] = {    2.0, 60.0}",
        "e_v = ocv_v(soc, temperature_degc) - (branch_v[1] + branch_v[2]);",
        "      + lost_w(twice_a, 2, branch_v[2], branch_ohm[2]);",
        "constant Integer n_transfer = 1",
        "/ 298.15 / max(branch_ohm[1], 1e-5);",
        "end a__cell____;",
    ] {
        assert!(text.contains(wanted), "{wanted}\n{text}");
    }
    let point = bare().text(ModelFormat::Modelica).unwrap();
    assert!(point.contains("tau_s[n_rc] = fill(0.0, 0)") && point.contains("- 0.0;"));
    assert!(!point.contains('@') && !text.contains('@'));
}

#[test]
fn the_table_of_the_open_circuit_voltage_keeps_its_tolerance() {
    let curve = cell().curve;
    let soc = super::super::tables::dense_soc(&curve, 5e-7);
    let mut worst_v = 0.0_f64;
    for pair in soc.windows(2) {
        let ends = [pair[0], pair[1]].map(|soc| curve.voltage_v(soc));
        for share in [0.25, 0.5, 0.75] {
            let line_v = ends[0] + share * (ends[1] - ends[0]);
            let there = pair[0] + share * (pair[1] - pair[0]);
            worst_v = worst_v.max((curve.voltage_v(there) - line_v).abs());
        }
    }
    assert!(worst_v < 5.1e-7 && worst_v > 1e-7, "{worst_v}");
}

#[test]
fn an_fmu_lists_the_states_that_its_source_has() {
    let (_, added) = additions::augmented(&[
        ("surface_soc", &[4e-3, 300.0]),
        ("hysteresis", &[0.02, 60.0, 0.0, 0.0]),
    ]);
    let size =
        "int main(void) { printf(\"%zu\\n\", sizeof(eis_state) / sizeof(double)); return 0; }\n";
    for model in [cell(), bare(), mapped(), added] {
        let fmu = model.fmu().unwrap();
        let archive = fmu.archive(Some(b"library")).unwrap();
        let mut archive = zip::ZipArchive::new(Cursor::new(archive)).unwrap();
        let mut text = |name: &str| {
            let mut text = String::new();
            archive
                .by_name(name)
                .unwrap()
                .read_to_string(&mut text)
                .unwrap();
            text
        };
        let description = text("modelDescription.xml");
        let states = description.matches(" derivative=\"").count();
        let listed = description.matches("<ContinuousStateDerivative ").count();
        assert_eq!(states, listed);
        assert_eq!(
            text(&format!("binaries/x86_64-linux/{}.so", fmu.identifier)),
            "library"
        );
        let source = text("sources/fmu.c");
        assert!(
            !source.contains('@') && !description.contains('@'),
            "{description}"
        );
        let token = description.split("instantiationToken=\"").nth(1).unwrap();
        let token = token.split('"').next().unwrap();
        assert!(source.contains(&format!("#define TOKEN \"{token}\"")));
        if let Some(met) = run(&model, &[], size, "") {
            assert_eq!(met[0][0], states as f64);
        }
        compiles(&fmu.code());
    }
}

/// Compiles a library with all warnings.
fn compiles(code: &str) {
    let child = Command::new("cc")
        .args([
            "-std=c99", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared",
        ])
        .args(["-o", "/dev/null", "-x", "c", "-", "-lm"])
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let Ok(mut child) = child else {
        return;
    };
    child
        .stdin
        .take()
        .unwrap()
        .write_all(code.as_bytes())
        .unwrap();
    let ended = child.wait_with_output().unwrap();
    let message = String::from_utf8_lossy(&ended.stderr);
    assert!(ended.status.success(), "{message}");
}
