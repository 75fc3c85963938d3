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

/// Codes, and below each the real and imaginary parts of the impedances that pyimpspec 5.1.2
/// computes at 0.001, 1 and 1000 Hz from the values in the code.
const SEEN: &str = "\
Tlmbo{R_i=0.3,Y=0.2,n=0.8}
8.93089573145e1 -2.745569524744e2 4.545754292385e-1 -1.094659870939e0 2.99729633704e-2 -2.177661496912e-2
Tlmbs{R_i=0.3,Y=0.2,n=0.8}
2.999678523171e-1 -9.880748344004e-5 2.899679383072e-1 -2.308307939405e-2 2.997319026944e-2 -2.177681504071e-2
Tlmno{R_i=0.3,R_ct=0.5,Y=0.2,n=0.8}
5.959449061139e-1 -8.286224282799e-4 4.847047552278e-1 -1.433386337905e-1 3.002418720244e-2 -2.161541927334e-2
Tlmns{R_i=0.3,R_ct=0.5,Y=0.2,n=0.8}
2.515658855862e-1 -6.437530724347e-5 2.452826050342e-1 -1.527771519605e-2 3.002440931716e-2 -2.161559702936e-2
Tlmbq{R_i=0.3,Y=0.2,n=0.8,Y_B=0.4,n_B=0.7}
2.845190000144e1 -6.073600123066e1 3.698965342788e-1 -4.143988672774e-1 2.997317357985e-2 -2.177677923956e-2
Tlmnq{R_i=0.3,R_ct=0.5,Y=0.2,n=0.8,R_B=0.6,Y_B=0.4,n_B=0.7}
4.240673089004e-1 -8.552364266426e-4 3.403398423913e-1 -8.26998821184e-2 3.002439197431e-2 -2.161556428921e-2
Ga{R=0.3,tau=0.2,n=0.4}
2.999998673527e-1 -1.507963140207e-4 2.323503866756e-1 -8.731276267749e-2 1.397961794225e-2 -1.014998976674e-2
Ha{R=0.3,tau=0.2,a=0.8,b=0.6}
2.997315084838e-1 -8.162346421228e-4 1.938299748235e-1 -8.578280861565e-2 7.123782676247e-3 -6.66438034727e-3
H{dC=0.3,tau=0.2,a=0.8,b=0.6}
1.445996144639e0 -5.309877617633e2 3.038757634615e-1 -6.866204608093e-1 1.114590218591e-2 -1.191423369701e-2
G{Y=0.3,k=0.2,n=0.5}
7.450803270368e0 -1.17008080621e-1 9.549150830811e-1 -9.250028350952e-1 2.97358751782e-2 -2.973492867096e-2
G{Y=0.3,k=0.2,n=0.4}
6.343760729296e0 -7.969603006287e-2 1.30448533139e0 -9.226270978765e-1 8.157713708677e-2 -5.926767247098e-2
W{Y=0.3}
2.973540193588e1 -2.973540193588e1 9.403159725796e-1 -9.403159725796e-1 2.973540193588e-2 -2.973540193588e-2
W{Y=0.3,n=0.4}
2.049106082762e1 -1.488762713521e1 1.292898532538e0 -9.393457682846e-1 8.157638247725e-2 -5.926871115055e-2
Wo{Y=0.3,B=0.2}
2.721655242471e-1 -6.497473571623e2 2.694795564176e-1 -6.722107581897e-1 1.628675039676e-2 -1.628675039676e-2
Wo{Y=0.3,B=0.2,n=0.4}
5.526001132669e1 -1.692006983114e2 4.934447266456e-1 -6.935014466009e-1 3.961295087353e-2 -2.878049346948e-2
Ws{Y=0.3,B=0.2}
8.164964090131e-1 -3.420132006008e-4 6.799390634234e-1 -2.725777220463e-1 1.628675039676e-2 -1.628675039676e-2
Ws{Y=0.3,B=0.2,n=0.4}
8.498623159008e-1 -1.286773290576e-3 6.750561973923e-1 -2.119750786714e-1 3.96129508736e-2 -2.878049346938e-2
Zarc{R=0.3,tau=0.2,n=0.8}
2.995514135048e-1 -1.359579648154e-3 1.292077834674e-1 -1.076048481949e-1 3.100826596565e-4 -9.442038227627e-4
Ls{R_i=0.3,R_r=1,Y=0.2,n=0.8,d=0.7}
1.49635118087e0 -4.698415586969e-3 8.590313337337e-1 -5.156915886046e-1 3.000310698543e-2 -2.170241659342e-2
Tlmnq{R_i=0.3,R_ct=0.5,Y=0.2,n=0.8,R_B=0.6,Y_B=0.4,n_B=0.7,L=0.5}
4.719365141941e-1 -1.560424312172e-3 3.367703281632e-1 -1.123588689447e-1 2.998546696201e-2 -2.168407430134e-2
R{R=0.1}(C{C=0.2}[R{R=0.3}W{Y=0.4}])(R{R=0.5}Q{Y=0.6,n=0.9})
2.196950692727e1 -2.228553039107e1 4.526614096571e-1 -7.005722446434e-1 1.00102222929e-1 -1.423596507812e-3
";

#[test]
fn values_give_the_impedance_that_pyimpspec_computes() {
    let lines: Vec<&str> = SEEN.lines().collect();
    assert_eq!(lines.len(), 42);
    for pair in lines.chunks_exact(2) {
        let code = pair[0];
        let expected: Vec<f64> = pair[1].split(' ').map(|n| n.parse().unwrap()).collect();
        assert_eq!(expected.len(), 6, "{code}");
        let written = read(code);
        let mut p = vec![f64::NAN; written.circuit.parameter_names().len()];
        for (index, value) in written.guess.iter().chain(&written.constants) {
            p[*index] = *value;
        }
        for (freq_hz, expected) in [1e-3, 1.0, 1e3].into_iter().zip(expected.chunks_exact(2)) {
            let expected = Complex64::new(expected[0], expected[1]);
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
