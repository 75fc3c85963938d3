use super::*;
use crate::fit::{FitOptions, fit_erm};
use crate::formats::read_spectra;

fn folder() -> Option<std::path::PathBuf> {
    let above = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
    above.map(|a| a.join("shared/data/p45b/eis")).find(|f| f.is_dir())
}

#[test]
fn look() {
    let Some(folder) = folder() else { return };
    let out = Path::new("/tmp/plots");
    std::fs::create_dir_all(out).unwrap();
    let sweeps: Vec<Spectrum> = (0..5)
        .flat_map(|c| (0..5).map(move |r| (c, r)))
        .flat_map(|(c, r)| read_spectra(&folder.join(format!("cell{c}_{r}.csv"))).unwrap())
        .collect();
    let controls: Vec<Spectrum> = ["shunt_0.csv", "resistor_0.csv"].iter().flat_map(|f| read_spectra(&folder.join(f)).unwrap()).collect();
    let fits: Vec<_> = (1..=4).map(|rc| fit_erm(&sweeps, &FitOptions { rc, ..FitOptions::default() }).unwrap()).collect();
    write_thesis_figures(&FigureInput { sweeps: &sweeps, controls: &controls, fits: &fits }, out).unwrap();
    let mut one = sweeps[0].clone();
    for p in &mut one.points {
        let s = 0.006 * p.z_ohm.norm();
        p.covariance = Covariance2 { re_re: s * s, re_im: 0.3 * s * s, im_im: 0.5 * s * s };
    }
    let mut series = vec![Series::data(&one, 0)];
    for (i, f) in fits.iter().enumerate() {
        series.push(Series::model(&format!("{} RC", i + 1), &f.erm, (0.1, 201.0), i + 1));
    }
    let plot = ImpedancePlot::new("Cell 0 & fits", "2σ shown", series);
    nyquist(&plot, &out.join("many.png")).unwrap();
    bode(&plot, &out.join("bode.png")).unwrap();
    bode(&plot, &out.join("bode.svg")).unwrap();
}
