//! Circuit description codes of pyimpspec.

use crate::model::{Circuit, WrittenCircuit};
use num_complex::Complex64;

fn read(text: &str) -> WrittenCircuit {
    WrittenCircuit::read(text).unwrap_or_else(|error| panic!("{text}: {error}"))
}

#[test]
fn series_parallel_and_brackets_are_read() {
    let cases = [
        ("R(RC)", "R1-p(R2,C1)"),
        ("[R(C[RW])]", "R1-p(C1,R2-W1)"),
        ("!V=1![R(RQ)([RWo]Q)L]", "R1-p(R2,CPE1)-p(R3-Wo1,CPE2)-L1"),
        ("(R[L(RC)])", "p(R1,L1-p(R2,C1))"),
        (" [ R [ R C ] ] ", "R1-R2-C1"),
        (
            "[TlmboTlmnoTlmbqLsHaZarc]",
            "TLMQ1-Ls1-Tlmbq1-Ls2-Ha1-Zarc1",
        ),
        ("R{:sol}(R{:ct}Q{:dl})", "R1-p(R2,CPE1)"),
        // The plain ones have the exponent a half; free, it needs the general ones.
        ("[WGGaWoWs]", "W1-G1-G2-Wo1-Ws1"),
        (
            "[W{n=0.4}G{n=0.4}Ga{n=0.5}Wo{n=0.4}Ws{n=0.4F}]",
            "CPE1-Ga1-Ga2-TLMQ1-Tlmbs1",
        ),
    ];
    for (code, expected) in cases {
        let circuit = read(code).circuit;
        assert_eq!(circuit.to_string(), expected, "{code}");
        assert_eq!(circuit, expected.parse::<Circuit>().unwrap(), "{code}");
    }
}

/// Impedances that pyimpspec 5.1.2 computes at 0.001, 1 and 1000 Hz from the values in the code.
#[test]
fn values_give_the_impedance_that_pyimpspec_computes() {
    let c = Complex64::new;
    let seen = [
        (
            "Tlmbo{R_i=0.3,Y=0.2,n=0.8}",
            [
                c(8.930_895_731_45e1, -2.745_569_524_744e2),
                c(4.545_754_292_385e-1, -1.094_659_870_939e0),
                c(2.997_296_337_04e-2, -2.177_661_496_912e-2),
            ],
        ),
        (
            "Tlmbs{R_i=0.3,Y=0.2,n=0.8}",
            [
                c(2.999_678_523_171e-1, -9.880_748_344_004e-5),
                c(2.899_679_383_072e-1, -2.308_307_939_405e-2),
                c(2.997_319_026_944e-2, -2.177_681_504_071e-2),
            ],
        ),
        (
            "Tlmno{R_i=0.3,R_ct=0.5,Y=0.2,n=0.8}",
            [
                c(5.959_449_061_139e-1, -8.286_224_282_799e-4),
                c(4.847_047_552_278e-1, -1.433_386_337_905e-1),
                c(3.002_418_720_244e-2, -2.161_541_927_334e-2),
            ],
        ),
        (
            "Tlmns{R_i=0.3,R_ct=0.5,Y=0.2,n=0.8}",
            [
                c(2.515_658_855_862e-1, -6.437_530_724_347e-5),
                c(2.452_826_050_342e-1, -1.527_771_519_605e-2),
                c(3.002_440_931_716e-2, -2.161_559_702_936e-2),
            ],
        ),
        (
            "Tlmbq{R_i=0.3,Y=0.2,n=0.8,Y_B=0.4,n_B=0.7}",
            [
                c(2.845_190_000_144e1, -6.073_600_123_066e1),
                c(3.698_965_342_788e-1, -4.143_988_672_774e-1),
                c(2.997_317_357_985e-2, -2.177_677_923_956e-2),
            ],
        ),
        (
            "Tlmnq{R_i=0.3,R_ct=0.5,Y=0.2,n=0.8,R_B=0.6,Y_B=0.4,n_B=0.7}",
            [
                c(4.240_673_089_004e-1, -8.552_364_266_426e-4),
                c(3.403_398_423_913e-1, -8.269_988_211_84e-2),
                c(3.002_439_197_431e-2, -2.161_556_428_921e-2),
            ],
        ),
        (
            "Ga{R=0.3,tau=0.2,n=0.4}",
            [
                c(2.999_998_673_527e-1, -1.507_963_140_207e-4),
                c(2.323_503_866_756e-1, -8.731_276_267_749e-2),
                c(1.397_961_794_225e-2, -1.014_998_976_674e-2),
            ],
        ),
        (
            "Ha{R=0.3,tau=0.2,a=0.8,b=0.6}",
            [
                c(2.997_315_084_838e-1, -8.162_346_421_228e-4),
                c(1.938_299_748_235e-1, -8.578_280_861_565e-2),
                c(7.123_782_676_247e-3, -6.664_380_347_27e-3),
            ],
        ),
        (
            "H{dC=0.3,tau=0.2,a=0.8,b=0.6}",
            [
                c(1.445_996_144_639e0, -5.309_877_617_633e2),
                c(3.038_757_634_615e-1, -6.866_204_608_093e-1),
                c(1.114_590_218_591e-2, -1.191_423_369_701e-2),
            ],
        ),
        (
            "G{Y=0.3,k=0.2,n=0.5}",
            [
                c(7.450_803_270_368e0, -1.170_080_806_21e-1),
                c(9.549_150_830_811e-1, -9.250_028_350_952e-1),
                c(2.973_587_517_82e-2, -2.973_492_867_096e-2),
            ],
        ),
        (
            "G{Y=0.3,k=0.2,n=0.4}",
            [
                c(6.343_760_729_296e0, -7.969_603_006_287e-2),
                c(1.304_485_331_39e0, -9.226_270_978_765e-1),
                c(8.157_713_708_677e-2, -5.926_767_247_098e-2),
            ],
        ),
        (
            "W{Y=0.3}",
            [
                c(2.973_540_193_588e1, -2.973_540_193_588e1),
                c(9.403_159_725_796e-1, -9.403_159_725_796e-1),
                c(2.973_540_193_588e-2, -2.973_540_193_588e-2),
            ],
        ),
        (
            "W{Y=0.3,n=0.4}",
            [
                c(2.049_106_082_762e1, -1.488_762_713_521e1),
                c(1.292_898_532_538e0, -9.393_457_682_846e-1),
                c(8.157_638_247_725e-2, -5.926_871_115_055e-2),
            ],
        ),
        (
            "Wo{Y=0.3,B=0.2}",
            [
                c(2.721_655_242_471e-1, -6.497_473_571_623e2),
                c(2.694_795_564_176e-1, -6.722_107_581_897e-1),
                c(1.628_675_039_676e-2, -1.628_675_039_676e-2),
            ],
        ),
        (
            "Wo{Y=0.3,B=0.2,n=0.4}",
            [
                c(5.526_001_132_669e1, -1.692_006_983_114e2),
                c(4.934_447_266_456e-1, -6.935_014_466_009e-1),
                c(3.961_295_087_353e-2, -2.878_049_346_948e-2),
            ],
        ),
        (
            "Ws{Y=0.3,B=0.2}",
            [
                c(8.164_964_090_131e-1, -3.420_132_006_008e-4),
                c(6.799_390_634_234e-1, -2.725_777_220_463e-1),
                c(1.628_675_039_676e-2, -1.628_675_039_676e-2),
            ],
        ),
        (
            "Ws{Y=0.3,B=0.2,n=0.4}",
            [
                c(8.498_623_159_008e-1, -1.286_773_290_576e-3),
                c(6.750_561_973_923e-1, -2.119_750_786_714e-1),
                c(3.961_295_087_36e-2, -2.878_049_346_938e-2),
            ],
        ),
        (
            "Zarc{R=0.3,tau=0.2,n=0.8}",
            [
                c(2.995_514_135_048e-1, -1.359_579_648_154e-3),
                c(1.292_077_834_674e-1, -1.076_048_481_949e-1),
                c(3.100_826_596_565e-4, -9.442_038_227_627e-4),
            ],
        ),
        (
            "Ls{R_i=0.3,R_r=1,Y=0.2,n=0.8,d=0.7}",
            [
                c(1.496_351_180_87e0, -4.698_415_586_969e-3),
                c(8.590_313_337_337e-1, -5.156_915_886_046e-1),
                c(3.000_310_698_543e-2, -2.170_241_659_342e-2),
            ],
        ),
        (
            "Tlmnq{R_i=0.3,R_ct=0.5,Y=0.2,n=0.8,R_B=0.6,Y_B=0.4,n_B=0.7,L=0.5}",
            [
                c(4.719_365_141_941e-1, -1.560_424_312_172e-3),
                c(3.367_703_281_632e-1, -1.123_588_689_447e-1),
                c(2.998_546_696_201e-2, -2.168_407_430_134e-2),
            ],
        ),
        (
            "R{R=0.1}(C{C=0.2}[R{R=0.3}W{Y=0.4}])(R{R=0.5}Q{Y=0.6,n=0.9})",
            [
                c(2.196_950_692_727e1, -2.228_553_039_107e1),
                c(4.526_614_096_571e-1, -7.005_722_446_434e-1),
                c(1.001_022_229_29e-1, -1.423_596_507_812e-3),
            ],
        ),
    ];
    for (code, expected) in seen {
        let written = read(code);
        let mut p = vec![f64::NAN; written.circuit.parameter_names().len()];
        for (index, value) in written.guess.iter().chain(&written.constants) {
            p[*index] = *value;
        }
        for (freq_hz, expected) in [1e-3, 1.0, 1e3].into_iter().zip(expected) {
            let z = written.circuit.impedance(&p, freq_hz);
            assert!(
                (z - expected).norm() <= 1e-11 * expected.norm(),
                "{code} at {freq_hz} Hz: expected {expected}, met {z}"
            );
        }
    }
}

#[test]
fn what_is_held_is_a_constant_and_limits_are_passed_over() {
    let written = read(
        "[R{R=1.0000E+03F/0.0000E+00/inf:sol}(C{C=1.5E-06/10%/1e3}Tlmbo{R_i=3,Y=2,n=0.9F,L=0.5F})]",
    );
    assert_eq!(written.circuit.to_string(), "R1-p(C1,TLMQ1)");
    assert_eq!(written.constants, [(0, 1000.0), (4, 0.9)]);
    // The storage is that of the whole pore, Y·L².
    assert_eq!(written.guess, [(1, 1.5e-6), (2, 3.0), (3, 0.5)]);
    // A part that is missing leaves the parameter free.
    assert!(read("(RLs{R_i=3})").guess.is_empty());
}

#[test]
fn errors_show_the_place() {
    let cases = [
        ("R(RC", 5, "\")\""),
        ("R(R)", 4, "a second element in parallel"),
        ("[]", 2, "an element such as R"),
        ("[RC])", 5, "or the end"),
        ("[RX]", 3, "one of the symbols R, C"),
        ("R(RTlm{})", 4, "met \"Tlm\""),
        ("[R{Q=3}]", 4, "each of R once"),
        ("[R{R=3,R=4}]", 8, "each of R once"),
        ("[R{R=x}]", 6, "a number"),
        ("[R{R=-3}]", 2, "from 1e-12 to 1e12 Ω, met -3e0"),
        ("[R{R=3", 7, "each of R once"),
        ("[R{R 3}]", 6, "\"=\" and a value"),
        ("!V=1", 5, "after the version"),
    ];
    for (code, place, expected) in cases {
        let error = WrittenCircuit::read(code).unwrap_err();
        let text = error.to_string();
        assert!(text.contains(expected), "{code}: {text}");
        assert_eq!(error.index() + 1, place, "{code}: {text}");
    }
    let deep = format!("{}R{}", "(R".repeat(40), ")".repeat(40));
    assert!(
        WrittenCircuit::read(&deep)
            .unwrap_err()
            .to_string()
            .contains("at most 32 levels")
    );
    let many = format!("[{}]", "R".repeat(65));
    assert!(
        WrittenCircuit::read(&many)
            .unwrap_err()
            .to_string()
            .contains("at most 64 elements")
    );
}
