//! Memory, open files and kernel drops of this process, from `/proc`. `None` outside Linux.

use std::{fs, net::SocketAddr};

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct ProcessFacts {
    pub(crate) resident_bytes: Option<u64>,
    pub(crate) open_files: Option<u64>,
    pub(crate) kernel_drops: Option<u64>,
}

/// `socket` is the local address of the UDP socket.
pub(crate) fn read(socket: Option<SocketAddr>) -> ProcessFacts {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let drops = |socket: SocketAddr| {
        let table = if socket.is_ipv4() { "/proc/self/net/udp" } else { "/proc/self/net/udp6" };
        kernel_drops(&fs::read_to_string(table).ok()?, socket.port())
    };
    ProcessFacts {
        resident_bytes: resident_bytes(&status),
        open_files: fs::read_dir("/proc/self/fd").ok().map(|files| files.count() as u64),
        kernel_drops: socket.and_then(drops),
    }
}

fn resident_bytes(status: &str) -> Option<u64> {
    let kib = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?.trim().strip_suffix("kB")?;
    kib.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}

/// Sums the last column over the sockets with this local port: datagrams dropped because the buffer was full.
fn kernel_drops(table: &str, port: u16) -> Option<u64> {
    let wanted = format!(":{port:04X}");
    let lines = table.lines().skip(1).map(|line| line.split_ascii_whitespace().collect::<Vec<_>>());
    let drops = lines.filter(|columns| columns.get(1).is_some_and(|local| local.ends_with(&wanted)));
    drops.map(|columns| columns.last().and_then(|drops| drops.parse::<u64>().ok())).reduce(|a, b| Some(a? + b?))?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernels_tables_are_read() {
        assert_eq!(resident_bytes("Name:\tx\nVmRSS:\t   12 kB\n"), Some(12 * 1024));
        let table = "  sl  local_address rem_address   st tx_queue rx_queue \
                     tr tm->when retrnsmt   uid  timeout inode ref pointer drops\n \
                     5: 0100007F:1151 00000000:0000 07 00000000:00000000 \
                     00:00000000 00000000     0        0 1 2 0 17\n \
                     6: 00000000:1152 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 1 2 0 3\n";
        assert_eq!(kernel_drops(table, 0x1151), Some(17));
        assert_eq!(kernel_drops(table, 0x1152), Some(3));
        assert_eq!(kernel_drops(table, 9), None);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn this_process_has_memory_and_files_and_its_socket_is_found() {
        let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        let facts = read(socket.local_addr().ok());
        assert!(facts.resident_bytes.unwrap() > 1 << 20 && facts.open_files.unwrap() > 0, "{facts:?}");
        assert_eq!(facts.kernel_drops, Some(0));
    }
}
