//! USBTMC through the kernel's driver: a separate thread reads and writes `/dev/usbtmcN` as a file,
//! because the driver blocks.
//!
//! A read that returns fewer bytes than requested ends a message. The driver's device clear is an
//! ioctl, which requires unsafe code and is therefore missing here. A datagram socket in place of
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

use super::Arrival;

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
}

enum Order {
    Write(Vec<u8>),
    Read,
}

impl UsbTmc {
    pub(super) fn open(path: &str) -> io::Result<Self> {
        let mut device = Device::open(Path::new(path))?;
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
        })
    }

    pub(super) async fn send(&mut self, message: &[u8]) -> io::Result<()> {
        self.order(Order::Write(message.to_vec())).await.map(drop)
    }

    pub(super) async fn receive(&mut self) -> io::Result<Arrival> {
        loop {
            match self.order(Order::Read).await {
                // The driver's own time is over; the caller has a deadline.
                Err(error)
                    if matches!(
                        error.kind(),
                        io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock
                    ) => {}
                other => return other,
            }
        }
    }

    /// Waits until the driver has completed all orders, and discards their results.
    pub(super) async fn settle(&mut self) -> io::Result<()> {
        while self.under_way > 0 {
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
            return Ok(Self::File(
                File::options()
                    .read(true)
                    .write(true)
                    .custom_flags(nix::libc::O_NOCTTY)
                    .open(path)?,
            ));
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
