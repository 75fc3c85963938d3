//! One name for one result: blocks of equal shape side by side are interchangeable, so they are put
//! by rising time constant.

use analysis_model::model::{Circuit, ElementKind, Node, Role};

/// Puts interchangeable blocks that hold no constant in order, by exchanging their parameters.
pub(super) fn order(circuit: &Circuit, constants: &[(usize, f64)], parameters: &mut [f64]) {
    order_node(circuit.root(), constants, parameters);
}

fn order_node(node: &Node, constants: &[(usize, f64)], parameters: &mut [f64]) {
    let (Node::Series(children) | Node::Parallel(children)) = node else {
        return;
    };
    children
        .iter()
        .for_each(|child| order_node(child, constants, parameters));
    let free = |child: &&Node| !constants.iter().any(|(i, _)| child.range().contains(i));
    let mut left: Vec<&Node> = children.iter().filter(free).collect();
    while let Some(first) = left.first().copied() {
        let (same, others): (Vec<&Node>, Vec<&Node>) =
            left.into_iter().partition(|child| same_shape(child, first));
        left = others;
        let mut values: Vec<(f64, Vec<f64>)> = same
            .iter()
            .map(|block| {
                (
                    time_constant_s(block, parameters),
                    parameters[block.range()].to_vec(),
                )
            })
            .collect();
        values.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (block, (_, values)) in same.iter().zip(values) {
            parameters[block.range()].copy_from_slice(&values);
        }
    }
}

/// Returns whether the nodes are equal except for names.
fn same_shape(a: &Node, b: &Node) -> bool {
    let all = |a: &[Node], b: &[Node]| {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same_shape(a, b))
    };
    match (a, b) {
        (Node::Element(a), Node::Element(b)) => a.kind == b.kind,
        (Node::Series(a), Node::Series(b)) | (Node::Parallel(a), Node::Parallel(b)) => all(a, b),
        _ => false,
    }
}

/// Sort key of a block: RC, (RQ)^(1/α), L/R, or its own τ, in s. A block without any of them is
/// sorted by its level.
fn time_constant_s(block: &Node, parameters: &[f64]) -> f64 {
    let (mut time, mut resistance, mut storage, mut level) = (None, None, None, None);
    block.visit(&mut |element| {
        let p = &parameters[element.first..];
        for (k, kind) in element.kind.parameters().iter().enumerate() {
            if kind.role == Role::Time {
                time.get_or_insert(p[k]);
            }
        }
        level.get_or_insert(p[0]);
        match element.kind {
            ElementKind::R
            | ElementKind::Wo
            | ElementKind::Ws
            | ElementKind::K
            | ElementKind::G => {
                resistance.get_or_insert(p[0]);
            }
            ElementKind::C => {
                storage.get_or_insert((p[0], 1.0));
            }
            ElementKind::Cpe => {
                storage.get_or_insert((p[0], p[1]));
            }
            ElementKind::L => {
                storage.get_or_insert((p[0], -1.0));
            }
            _ => {}
        }
    });
    match (resistance, storage, time) {
        (Some(r), Some((l, -1.0)), _) => l / r,
        (Some(r), Some((q, alpha)), _) => (r * q).powf(1.0 / alpha),
        (_, _, Some(time)) => time,
        _ => level.unwrap_or(0.0),
    }
}
