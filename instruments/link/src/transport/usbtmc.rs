//! USBTMC through the kernel's driver: a separate thread reads and writes `/dev/usbtmcN` as a file,
//! because the driver blocks.
//!
//! The header of a transfer, with its mark of the end, and the device clear are ioctls, which
//! require unsafe code and are therefore missing here. So a reply ends as IEEE 488.2 has it: with a
//! NL, or with the last byte that the head of a block counts; a read that returns fewer bytes than
//! requested ends a transfer only, since instruments send replies in pieces. A datagram socket in place of
//! the device file is a simulated instrument.

use std::{
    fs::File,
    io::{self, Read, Write},
    os::unix::{
        fs::{FileTypeExt, OpenOptionsExt},
        net::UnixDatagram,
    },
    path::{Path, PathBuf},
    sync::{
        atomic::{AtomicU32, Ordering},
        mpsc as blocking,
    },
    time::Duration,
};

use tokio::sync::mpsc;

use super::{
    Arrival,
    usb::{explained, usb_file},
};

/// Bytes in a full transfer through the socket in place of a device file; a shorter one ends a
/// message.
pub const TRANSFER: usize = 32 << 10;
/// Number of bytes requested from the driver at once.
const PAGE: usize = 256 << 10;
/// Timeout of a read from the socket in place of a device file; the driver has a timeout of its
/// own.
const SOCKET_PATIENCE: Duration = Duration::from_millis(500);

/// An open device.
#[derive(Debug)]
pub struct UsbTmc {
    orders: blocking::Sender<Order>,
    results: mpsc::UnboundedReceiver<io::Result<Arrival>>,
    /// Outstanding orders: their results have not arrived.
    under_way: usize,
    /// The reply that is being read.
    reply: Reply,
}

/// As much of a reply as is needed to find its end.
#[derive(Debug, Default)]
struct Reply {
    head: Vec<u8>,
    length: usize,
    last: Option<u8>,
}

impl Reply {
    /// Takes a transfer, and returns whether it may be the last one.
    fn take(&mut self, bytes: &[u8]) -> bool {
        let room = BLOCK_HEAD.saturating_sub(self.head.len());
        self.head.extend(bytes.iter().take(room));
        self.length += bytes.len();
        self.last = bytes.last().copied().or(self.last);
        match block_length(&self.head) {
            Some(length) => self.length >= length,
            // A transfer without data, as behind a full one, ends as well.
            None => bytes.is_empty() || self.last == Some(b'\n'),
        }
    }

    fn is_begun(&self) -> bool {
        self.length > 0
    }
}

/// Most bytes before the data of a block: `#`, a digit, nine digits.
const BLOCK_HEAD: usize = 11;

/// Returns the length of a block with its head, if a reply begins with a complete head.
fn block_length(reply: &[u8]) -> Option<usize> {
    let (b'#', rest) = reply.split_first()? else {
        return None;
    };
    let (digits, rest) = rest.split_first()?;
    let digits = usize::from(
        digits
            .checked_sub(b'0')
            .filter(|digit| (1..=9).contains(digit))?,
    );
    let count = std::str::from_utf8(rest.get(..digits)?).ok()?;
    let is_number = count.bytes().all(|byte| byte.is_ascii_digit());
    let count: usize = count.parse().ok().filter(|_| is_number)?;
    count.checked_add(digits + 2)
}

enum Order {
    Write(Vec<u8>),
    Read,
}

impl UsbTmc {
    pub(super) fn open(path: &str) -> io::Result<Self> {
        let mut device = Device::open(&usb_file(path)?)?;
        let (orders, to_do) = blocking::channel();
        let (done, results) = mpsc::unbounded_channel();
        std::thread::Builder::new()
            .name("usbtmc".to_owned())
            .spawn(move || {
                while let Ok(order) = to_do.recv() {
                    let result = match order {
                        Order::Write(message) => device.write(&message).map(|()| Arrival {
                            bytes: Vec::new(),
                            end: true,
                        }),
                        Order::Read => device.read(),
                    };
                    if done.send(result).is_err() {
                        return;
                    }
                }
            })?;
        Ok(Self {
            orders,
            results,
            under_way: 0,
            reply: Reply::default(),
        })
    }

    pub(super) async fn send(&mut self, message: &[u8]) -> io::Result<()> {
        self.reply = Reply::default();
        self.order(Order::Write(message.to_vec())).await.map(drop)
    }

    pub(super) async fn receive(&mut self) -> io::Result<Arrival> {
        loop {
            match self.order(Order::Read).await {
                // The driver's own time is over. What has come is a reply without a NL; before it,
                // the caller has a deadline.
                Err(error)
                    if matches!(
                        error.kind(),
                        io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock
                    ) =>
                {
                    if std::mem::take(&mut self.reply).is_begun() {
                        return Ok(Arrival {
                            bytes: Vec::new(),
                            end: true,
                        });
                    }
                }
                Ok(arrival) => {
                    let is_whole = self.reply.take(&arrival.bytes);
                    let end = arrival.end && is_whole;
                    if end {
                        self.reply = Reply::default();
                    }
                    return Ok(Arrival { end, ..arrival });
                }
                Err(error) => return Err(error),
            }
        }
    }

    /// Waits until the driver has completed all orders, and discards their results.
    pub(super) async fn settle(&mut self) -> io::Result<()> {
        while self.under_way > 0 {
            self.reply = Reply::default();
            let _ = self.result().await?;
        }
        Ok(())
    }

    /// Places an order behind those that were given up. May be abandoned.
    async fn order(&mut self, order: Order) -> io::Result<Arrival> {
        self.settle().await?;
        self.orders
            .send(order)
            .map_err(|_| io::ErrorKind::BrokenPipe)?;
        self.under_way += 1;
        self.result().await?
    }

    async fn result(&mut self) -> io::Result<io::Result<Arrival>> {
        let result = self.results.recv().await.ok_or(io::ErrorKind::BrokenPipe)?;
        self.under_way -= 1;
        Ok(result)
    }
}

/// Object that is opened under the path.
enum Device {
    File(File),
    Socket {
        socket: UnixDatagram,
        own_path: PathBuf,
    },
}

impl Device {
    fn open(path: &Path) -> io::Result<Self> {
        /// Numbers the clients of this process.
        static CLIENTS: AtomicU32 = AtomicU32::new(0);
        if !std::fs::metadata(path)?.file_type().is_socket() {
            let file = File::options()
                .read(true)
                .write(true)
                .custom_flags(nix::libc::O_NOCTTY)
                .open(path);
            return file.map(Self::File).map_err(|error| explained(path, error));
        }
        let number = CLIENTS.fetch_add(1, Ordering::Relaxed);
        let own_path = path.with_extension(format!("client-{}-{number}", std::process::id()));
        let device = Self::Socket {
            socket: UnixDatagram::bind(&own_path)?,
            own_path,
        };
        if let Self::Socket { socket, .. } = &device {
            socket.connect(path)?;
            socket.set_read_timeout(Some(SOCKET_PATIENCE))?;
        }
        Ok(device)
    }

    fn write(&mut self, message: &[u8]) -> io::Result<()> {
        match self {
            Self::File(file) => file.write_all(message),
            Self::Socket { socket, .. } => {
                let mut transfers = message.chunks(TRANSFER).collect::<Vec<_>>();
                if message.len().is_multiple_of(TRANSFER) {
                    transfers.push(&[]);
                }
                transfers
                    .into_iter()
                    .try_for_each(|transfer| socket.send(transfer).map(drop))
            }
        }
    }

    fn read(&mut self) -> io::Result<Arrival> {
        let (asked, mut bytes) = match self {
            Self::File(_) => (PAGE, vec![0; PAGE]),
            Self::Socket { .. } => (TRANSFER, vec![0; TRANSFER]),
        };
        let count = match self {
            Self::File(file) => match file.read(&mut bytes)? {
                0 => return Err(io::ErrorKind::UnexpectedEof.into()),
                count => count,
            },
            Self::Socket { socket, .. } => socket.recv(&mut bytes)?,
        };
        bytes.truncate(count);
        Ok(Arrival {
            bytes,
            end: count < asked,
        })
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        if let Self::Socket { own_path, .. } = self {
            let _ = std::fs::remove_file(own_path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reply_ends_with_its_line_or_its_count_and_not_with_a_piece() {
        let table: [(&[&[u8]], &[bool]); 6] = [
            (&[b"SIGLENT,SDS8", b"24X HD,1\n"], &[false, true]),
            (&[b"1.0\n"], &[true]),
            (&[b"#210abc\n", b"efghij\n"], &[false, true]),
            (&[b"#", b"14ab\nd", b""], &[false, true, true]),
            (&[b"1.0", b""], &[false, true]),
            (&[b"#0abc\n"], &[true]),
        ];
        for (transfers, ends) in table {
            let mut reply = Reply::default();
            let found: Vec<bool> = transfers.iter().map(|piece| reply.take(piece)).collect();
            assert_eq!(found, ends, "{transfers:?}");
        }
        assert_eq!(block_length(b"#9999999999"), Some(999_999_999 + 11));
        assert_eq!(block_length(b"#2+1"), None);
    }
}
