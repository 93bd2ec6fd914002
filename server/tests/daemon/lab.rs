//! The lab transports: control over TCP, and one data port per session.

use gnomon_protocol::message::ClientMessage;
use gnomon_server::config::Transport;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::{TcpStream, UdpSocket},
};

use super::{
    Rig,
    client::{Control, Frames, hello, pose_packet},
    soon,
};

async fn connect(rig: &Rig) -> (Control, u16) {
    let (read, write) = TcpStream::connect(rig.address()).await.unwrap().into_split();
    let mut control = Control::new(read, write);
    let welcome = control.welcome(hello()).await;
    assert_eq!(control.fetch(&welcome, 0).await.len() as u64, welcome.scene_bytes);
    (control, welcome.data_port.unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_arrive_over_udp() {
    let rig = Rig::start(|config, _| config.transport = Transport::LabUdp).await;
    assert_eq!(rig.server.url(), format!("gnomon+lab-udp://{}/", rig.address()));
    let (mut control, port) = connect(&rig).await;
    control.send(&ClientMessage::Start).await;
    let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    socket.connect(("127.0.0.1", port)).await.unwrap();
    let (mut frames, mut buffer) = (Frames::new(), vec![0; 65_536]);
    // A stranger that sends something else first does not become the client.
    let stranger = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    stranger.send_to(b"not a pose", ("127.0.0.1", port)).await.unwrap();
    for number in 0..3 {
        soon(async {
            for sequence in 0.. {
                socket.send(&pose_packet(number * 1000 + sequence, number)).await.unwrap();
                let patience = std::time::Duration::from_millis(500);
                while let Ok(length) = tokio::time::timeout(patience, socket.recv(&mut buffer)).await {
                    if frames.push(&buffer[..length.unwrap()]).is_some_and(|(frame, _)| frame == number) {
                        return;
                    }
                }
            }
        })
        .await;
    }
    assert!(stranger.try_recv(&mut buffer).is_err());
    drop(control);
    rig.sessions(0).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_arrive_over_tcp() {
    let rig = Rig::start(|config, _| config.transport = Transport::LabTcp).await;
    assert_eq!(rig.server.url(), format!("gnomon+lab-tcp://{}/", rig.address()));
    let (mut control, port) = connect(&rig).await;
    control.send(&ClientMessage::Start).await;
    let mut data = TcpStream::connect(("127.0.0.1", port)).await.unwrap();
    let mut frames = Frames::new();
    for number in 0..3 {
        let packet = pose_packet(number, number);
        data.write_all(&u32::try_from(packet.len()).unwrap().to_le_bytes()).await.unwrap();
        data.write_all(&packet).await.unwrap();
        let received = soon(async {
            loop {
                let length = data.read_u32_le().await.unwrap() as usize;
                let mut packet = vec![0; length];
                data.read_exact(&mut packet).await.unwrap();
                if let Some((frame, _)) = frames.push(&packet) {
                    return frame;
                }
            }
        });
        assert_eq!(received.await, number, "nothing is lost on TCP");
    }
    drop(data);
    drop(control);
    rig.sessions(0).await;
}
