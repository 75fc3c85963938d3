//! A collector that accepts OTLP over HTTP, and parses the protobuf byte by byte: it shares no
//! code with the sender.

use std::{
    collections::BTreeMap,
    io::{BufRead, BufReader, Read, Write},
    net::TcpListener,
    sync::{Arc, Mutex},
};

use crate::observe::Values;

/// A span as it arrived.
#[derive(Debug, Clone)]
pub(crate) struct Span {
    pub(crate) name: String,
    pub(crate) trace: String,
    pub(crate) id: String,
    pub(crate) parent: String,
    pub(crate) attributes: BTreeMap<String, String>,
    /// 2 is an error.
    pub(crate) status: u64,
}

/// Requests that arrived.
#[derive(Debug, Default)]
pub(crate) struct Arrived {
    pub(crate) spans: Vec<Span>,
    /// Each export of metrics.
    pub(crate) metrics: Vec<Values>,
    /// Attributes of the sender.
    pub(crate) resource: BTreeMap<String, String>,
}

/// A collector on a port of this machine.
pub(crate) struct Collector {
    pub(crate) address: String,
    pub(crate) arrived: Arc<Mutex<Arrived>>,
}

impl Collector {
    pub(crate) fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("http://{}", listener.local_addr().unwrap());
        let arrived = Arc::new(Mutex::new(Arrived::default()));
        let taken = arrived.clone();
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let taken = taken.clone();
                std::thread::spawn(move || serve(BufReader::new(stream.unwrap()), &taken));
            }
        });
        Self { address, arrived }
    }

    pub(crate) fn spans(&self) -> Vec<Span> {
        self.arrived.lock().unwrap().spans.clone()
    }
}

/// Handles the requests of a connection.
fn serve(mut stream: BufReader<std::net::TcpStream>, arrived: &Mutex<Arrived>) {
    loop {
        let (mut first, mut line, mut length) = (String::new(), String::new(), 0);
        if stream.read_line(&mut first).unwrap_or(0) == 0 {
            return;
        }
        while stream.read_line(&mut line).unwrap() > 2 {
            let value = line.to_lowercase();
            if let Some(found) = value.strip_prefix("content-length:") {
                length = found.trim().parse().unwrap();
            }
            line.clear();
        }
        let mut body = vec![0; length];
        stream.read_exact(&mut body).unwrap();
        take(&first, &body, &mut arrived.lock().unwrap());
        let answer = b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n";
        stream.get_mut().write_all(answer).unwrap();
    }
}

fn take(first: &str, body: &[u8], arrived: &mut Arrived) {
    let mut values = Values::new();
    // ExportTraceServiceRequest and ExportMetricsServiceRequest: 1 = content of one resource, with
    // 1 = resource and 2 = content of one scope, with 2 = span or metric.
    for of_resource in all(body, 1) {
        for resource in all(&of_resource, 1) {
            arrived.resource = attributes(&resource, 1);
        }
        for item in all(&of_resource, 2).iter().flat_map(|scope| all(scope, 2)) {
            if first.contains("/v1/traces") {
                arrived.spans.push(span(&item));
            } else {
                metric(&item, &mut values);
            }
        }
    }
    if first.contains("/v1/metrics") {
        arrived.metrics.push(values);
    }
}

/// Span: 1 trace, 2 number, 4 parent, 5 name, 9 attributes, 15 status with 3 = code.
fn span(bytes: &[u8]) -> Span {
    let hex = |number| {
        let bytes = all(bytes, number).concat();
        bytes.iter().map(|byte| format!("{byte:02x}")).collect()
    };
    let status = all(bytes, 15);
    Span {
        name: text(bytes, 5),
        trace: hex(1),
        id: hex(2),
        parent: hex(4),
        attributes: attributes(bytes, 9),
        status: status.first().map_or(0, |status| number(status, 3)),
    }
}

/// Metric: 1 name, 5 gauge, 7 sum, in either 1 = points: 4 value, 7 attributes.
fn metric(bytes: &[u8], values: &mut Values) {
    let name = text(bytes, 1);
    for data in [all(bytes, 5), all(bytes, 7)].concat() {
        for point in all(&data, 1) {
            let value = all(&point, 4).concat();
            let labels = attributes(&point, 7);
            let labels = labels.iter().map(|(key, value)| format!("{key}={value:?}"));
            let labels = labels.collect::<Vec<_>>().join(",");
            let labels = if labels.is_empty() {
                labels
            } else {
                format!("{{{labels}}}")
            };
            let value = f64::from_le_bytes(value.try_into().unwrap());
            values.insert(format!("{name}{labels}"), value);
        }
    }
}

/// KeyValue: 1 key, 2 value: 1 text, 2 Boolean, 3 integer, 4 number.
fn attributes(bytes: &[u8], field: u64) -> BTreeMap<String, String> {
    let one = |bytes: Vec<u8>| {
        let value = all(&bytes, 2).concat();
        let shown = match fields(&value).first() {
            Some((1, Field::Bytes(text))) => String::from_utf8(text.clone()).unwrap(),
            Some((4, Field::Bytes(bytes))) => {
                f64::from_le_bytes(bytes.clone().try_into().unwrap()).to_string()
            }
            Some((_, Field::Number(number))) => number.to_string(),
            other => panic!("{other:?}"),
        };
        (text(&bytes, 1), shown)
    };
    all(bytes, field).into_iter().map(one).collect()
}

#[derive(Debug)]
enum Field {
    Number(u64),
    Bytes(Vec<u8>),
}

/// Returns all fields with a length that a message has under a number.
fn all(bytes: &[u8], wanted: u64) -> Vec<Vec<u8>> {
    let found = |(number, field)| match field {
        Field::Bytes(bytes) if number == wanted => Some(bytes),
        _ => None,
    };
    fields(bytes).into_iter().filter_map(found).collect()
}

fn number(bytes: &[u8], wanted: u64) -> u64 {
    let found = |(number, field)| match field {
        Field::Number(value) if number == wanted => Some(value),
        _ => None,
    };
    fields(bytes).into_iter().find_map(found).unwrap_or(0)
}

fn text(bytes: &[u8], wanted: u64) -> String {
    String::from_utf8(all(bytes, wanted).concat()).unwrap()
}

/// Returns the fields of a message with their numbers (protobuf's wire format).
fn fields(mut bytes: &[u8]) -> Vec<(u64, Field)> {
    let mut found = Vec::new();
    while !bytes.is_empty() {
        let key = varint(&mut bytes);
        let length = match key & 7 {
            0 => {
                found.push((key >> 3, Field::Number(varint(&mut bytes))));
                continue;
            }
            1 => 8,
            2 => usize::try_from(varint(&mut bytes)).unwrap(),
            5 => 4,
            other => panic!("wire type {other}"),
        };
        let (value, rest) = bytes.split_at(length);
        found.push((key >> 3, Field::Bytes(value.to_vec())));
        bytes = rest;
    }
    found
}

fn varint(bytes: &mut &[u8]) -> u64 {
    let (mut value, mut shift) = (0, 0);
    loop {
        let byte = bytes[0];
        *bytes = &bytes[1..];
        value |= u64::from(byte & 0x7f) << shift;
        shift += 7;
        if byte & 0x80 == 0 {
            return value;
        }
    }
}
