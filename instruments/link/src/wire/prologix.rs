//! Messages to a GPIB adapter of the Prologix type (GPIB-ETHERNET and GPIB-USB manuals, sections 7
//! and 8): lines that start with `++` are for the adapter, all others for the instrument. In these,
//! an ESC precedes each CR, LF, ESC and `+` that belongs to the data.

const ESC: u8 = 0x1b;

/// Greatest primary address on a GPIB bus.
pub const MOST_ADDRESS: u8 = 30;

/// Returns data as a line for the adapter, its end included.
pub fn escaped(data: &[u8]) -> Vec<u8> {
    let mut line = Vec::with_capacity(data.len() + 8);
    for &byte in data {
        if matches!(byte, b'\r' | b'\n' | ESC | b'+') {
            line.push(ESC);
        }
        line.push(byte);
    }
    line.push(b'\n');
    line
}

/// A line as the adapter reads it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Line {
    /// For the adapter, without the `++`.
    Command(String),
    /// For the instrument, escapes taken out.
    Data(Vec<u8>),
    /// Longer than the adapter can hold.
    TooLong,
}

/// Cuts what comes from the controller into lines. An unescaped CR or LF ends one; empty ones do
/// not count.
#[derive(Debug)]
pub struct Lines {
    line: Vec<u8>,
    escaped: bool,
    /// Unescaped `+` with which the line began; two make it a command.
    pluses: usize,
    too_long: bool,
    limit: usize,
    ready: std::collections::VecDeque<Line>,
}

impl Lines {
    /// Creates a reader for lines of at most `limit` bytes.
    pub fn new(limit: usize) -> Self {
        Self {
            line: Vec::new(),
            escaped: false,
            pluses: 0,
            too_long: false,
            limit,
            ready: std::collections::VecDeque::new(),
        }
    }

    /// Takes in bytes from the stream.
    pub fn push(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            let plain = !std::mem::take(&mut self.escaped);
            match byte {
                ESC if plain => self.escaped = true,
                b'\r' | b'\n' if plain => self.finish(),
                _ if self.line.len() >= self.limit => self.too_long = true,
                _ => {
                    if plain && byte == b'+' && self.line.len() == self.pluses && self.pluses < 2 {
                        self.pluses += 1;
                    }
                    self.line.push(byte);
                }
            }
        }
    }

    /// Gives out the next line.
    pub fn pull(&mut self) -> Option<Line> {
        self.ready.pop_front()
    }

    /// Bytes that are held of a line without end.
    pub fn held(&self) -> usize {
        self.line.len()
    }

    fn finish(&mut self) {
        let line = std::mem::take(&mut self.line);
        let is_command = std::mem::take(&mut self.pluses) == 2;
        if std::mem::take(&mut self.too_long) {
            self.ready.push_back(Line::TooLong);
        } else if is_command {
            let text = line.get(2..).unwrap_or_default();
            self.ready.push_back(Line::Command(
                String::from_utf8_lossy(text).trim().to_owned(),
            ));
        } else if !line.is_empty() {
            self.ready.push_back(Line::Data(line));
        }
    }
}

/// Splits the data from the adapter at its reply to the version query. If the query follows a read,
/// that text marks the end of the data.
#[derive(Debug)]
pub struct Marked {
    buffer: Vec<u8>,
    mark: Vec<u8>,
    /// The buffer has been searched up to this index; it contains no mark before it.
    searched: usize,
}

impl Marked {
    /// Creates a reader for an adapter whose version text is `mark`, line end included.
    pub fn new(mark: Vec<u8>) -> Self {
        Self {
            buffer: Vec::new(),
            mark,
            searched: 0,
        }
    }

    /// Takes in bytes from the stream.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
    }

    /// Bytes that are held.
    pub fn held(&self) -> usize {
        self.buffer.len()
    }

    /// Returns the bytes that are certainly data, and whether the mark followed them.
    pub fn pull(&mut self) -> (Vec<u8>, bool) {
        let from = self.searched.saturating_sub(self.mark.len());
        let found = self.buffer.get(from..).and_then(|tail| {
            tail.windows(self.mark.len())
                .position(|window| window == self.mark)
        });
        if let Some(at) = found {
            let data = self.buffer.drain(..from + at).collect();
            self.buffer.drain(..self.mark.len());
            self.searched = 0;
            return (data, true);
        }
        let sure = (self.buffer.len() + 1).saturating_sub(self.mark.len());
        let data = self.buffer.drain(..sure).collect();
        self.searched = self.buffer.len();
        (data, false)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn lines(stream: &[u8], cut: usize) -> Vec<Line> {
        let mut lines = Lines::new(64);
        lines.push(&stream[..cut]);
        lines.push(&stream[cut..]);
        std::iter::from_fn(|| lines.pull()).collect()
    }

    #[test]
    fn commands_and_data_are_distinguished() {
        let command = |text: &str| Line::Command(text.to_owned());
        let data = |bytes: &[u8]| Line::Data(bytes.to_vec());
        let table: [(&[u8], Vec<Line>); 6] = [
            (
                b"++mode 1\n++addr 7\r\n",
                vec![command("mode 1"), command("addr 7")],
            ),
            (b"*IDN?\x1b\n\n", vec![data(b"*IDN?\n")]),
            (
                b"\x1b+\x1b+not a command\n\x1b++nor this\n+1\n",
                vec![data(b"++not a command"), data(b"++nor this"), data(b"+1")],
            ),
            (b"#14a\x1b\nb\x1b\x1b\n\r\n", vec![data(b"#14a\nb\x1b")]),
            (
                &[&[b'x'; 65][..], b"\n++ver\n"].concat(),
                vec![Line::TooLong, command("ver")],
            ),
            (b"\n\r\n", vec![]),
        ];
        for (stream, expected) in table {
            for cut in 0..=stream.len() {
                assert_eq!(
                    lines(stream, cut),
                    expected,
                    "{} cut at {cut}",
                    stream.escape_ascii()
                );
            }
        }
    }

    #[test]
    fn what_was_read_ends_before_the_adapters_name() {
        let stream = b"#15a\nProl\n\nPrologix 1.0\r\nProPrologix 1.0\r\nPrologix 1.0\r\n";
        for cut in 0..=stream.len() {
            let mut marked = Marked::new(b"Prologix 1.0\r\n".to_vec());
            let mut messages = vec![Vec::new()];
            for piece in [&stream[..cut], &stream[cut..]] {
                marked.push(piece);
                loop {
                    let (data, end) = marked.pull();
                    messages.last_mut().unwrap().extend(data);
                    if !end {
                        break;
                    }
                    messages.push(Vec::new());
                }
            }
            assert_eq!(
                messages,
                [&b"#15a\nProl\n\n"[..], b"Pro", b"", b""],
                "cut at {cut}"
            );
        }
    }

    proptest! {
        #[test]
        fn every_byte_reaches_the_instrument(
            data in prop::collection::vec(any::<u8>(), 1..60),
            cut in any::<prop::sample::Index>(),
        ) {
            let line = escaped(&data);
            prop_assert_eq!(
                lines(&line, cut.index(line.len() + 1)),
                vec![Line::Data(data)]
            );
        }
    }
}
