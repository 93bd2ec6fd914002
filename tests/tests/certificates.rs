//! Promise: a client trusts only the certificates that its URL pins, or one issued by its URL's authority. The operator
//! replaces certificate and key while the server runs. Clients of the authority notice nothing, nor do those whose URL
//! named the successor beforehand.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use std::{fs, path::Path, process::Command, time::Duration};

use gnomon_client::{
    ClientError,
    app::probe::{ProbeOptions, run_probe},
    camera_path::PathSpec,
};
use gnomon_lab::rig::{
    Ask, PATIENCE,
    program::{Program, find},
};
use rcgen::{BasicConstraints, CertificateParams, IsCa, Issuer, KeyPair};

/// Writes an authority's certificate to `NAME.pem`, and returns its issuer.
fn authority(folder: &Path, name: &str) -> Issuer<'static, KeyPair> {
    let mut params = CertificateParams::new(Vec::new()).unwrap();
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    let key = KeyPair::generate().unwrap();
    fs::write(folder.join(name).with_extension("pem"), params.self_signed(&key).unwrap().pem()).unwrap();
    Issuer::new(params, key)
}

fn issue(folder: &Path, authority: &Issuer<'_, KeyPair>) {
    let key = KeyPair::generate().unwrap();
    let leaf = CertificateParams::new(["localhost".to_owned()]).unwrap().signed_by(&key, authority).unwrap();
    fs::write(folder.join("chain.pem"), leaf.pem()).unwrap();
    fs::write(folder.join("key.pem"), key.serialize_pem()).unwrap();
}

/// Returns what asks a server for one mask.
fn prober(folder: &Path) -> impl Fn(&str) -> Result<u64, ClientError> {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let keyframe = |t: f64| serde_json::json!({ "t": t, "pos": [0.0, 2.5, 0.5], "target": [0.0, 0.0, 0.0] });
    let path = serde_json::json!({ "yfov_deg": 60.0, "camera_path": { "keyframes": [keyframe(0.0), keyframe(1.0)] } });
    fs::write(folder.join("path.json"), path.to_string()).unwrap();
    let path = folder.join("path.json").display().to_string().parse::<PathSpec>().unwrap().load().unwrap();
    move |url| {
        let ask = Ask { size: (32, 32), fps: None, frames: 1 };
        let options = ProbeOptions { connect_timeout: Duration::from_secs(5), ..ask.of(&url.parse().unwrap()) };
        run_probe(runtime.handle(), &options, &path).map(|report| report.masks)
    }
}

fn hang_up(server: &Program) {
    assert!(Command::new("kill").args(["-HUP", &server.id().to_string()]).status().unwrap().success());
}

#[test]
fn an_authority_is_trusted_across_certificate_rotations() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let ours = authority(folder, "ours");
    authority(folder, "theirs");
    issue(folder, &ours);
    let scene = gnomon_scene::testing::write_scene(folder).unwrap();
    let arguments = [
        format!("--scene={}", scene.display()),
        "--backend=cpu".to_owned(),
        "--listen=127.0.0.1:0".to_owned(),
        format!("--cert-file={}", folder.join("chain.pem").display()),
        format!("--key-file={}", folder.join("key.pem").display()),
    ];
    let mut server = Program::start(&find("gnomon-server").unwrap(), &arguments, &[]).unwrap();
    let pinning = server
        .wait_for(PATIENCE, |said| said.lines().find(|line| line.starts_with("gnomon://")).map(str::to_owned))
        .unwrap();
    let port = pinning.strip_prefix("gnomon://127.0.0.1:").unwrap().split('/').next().unwrap();
    let trusting = |host: &str, ca: &str| format!("gnomon://{host}:{port}/?ca={}", folder.join(ca).display());

    let masks = prober(folder);
    assert_eq!(masks(&pinning).unwrap(), 1);
    assert_eq!(masks(&trusting("localhost", "ours.pem")).unwrap(), 1);
    masks(&trusting("localhost", "theirs.pem")).unwrap_err();
    masks(&trusting("127.0.0.1", "ours.pem")).unwrap_err();
    masks(&trusting("localhost", "none.pem")).unwrap_err();

    issue(folder, &ours);
    hang_up(&server);
    server.wait_for(PATIENCE, |said| said.contains("certificate reloaded").then_some(())).unwrap();
    assert_eq!(masks(&trusting("localhost", "ours.pem")).unwrap(), 1);
    masks(&pinning).unwrap_err();
    server.terminate().unwrap();
    server.finish(PATIENCE).unwrap().success().unwrap();
}

#[test]
fn a_successor_that_was_announced_is_trusted_when_its_time_comes() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    let cert_dir = folder.join("cert");
    let certificate = |action: &str| {
        let arguments = ["certificate".into(), action.into(), "--cert-dir".into(), cert_dir.clone().into_os_string()];
        let command = Program::start(&find("gnomon-server").unwrap(), &arguments, &[]).unwrap();
        command.finish(PATIENCE).unwrap().success().unwrap().stdout.trim_end().to_owned()
    };
    let (first, second) = (certificate("identity"), certificate("spare"));
    let arguments = [
        format!("--scene={}", gnomon_scene::testing::write_scene(folder).unwrap().display()),
        "--backend=cpu".to_owned(),
        "--listen=127.0.0.1:0".to_owned(),
        format!("--cert-dir={}", cert_dir.display()),
    ];
    let mut server = Program::start(&find("gnomon-server").unwrap(), &arguments, &[]).unwrap();
    let url =
        server.wait_for(PATIENCE, |said| said.lines().find(|line| line.starts_with("gnomon://")).map(str::to_owned));
    let url = url.unwrap();
    let (base, pins) = url.split_once('?').unwrap();
    assert_eq!(pins, format!("cert={first}&cert={second}"));
    let masks = prober(folder);
    let only = |pin: &str| format!("{base}?cert={pin}");
    assert_eq!(masks(&url).unwrap(), 1);
    masks(&only(&second)).unwrap_err();

    assert_eq!(certificate("use-spare"), second);
    hang_up(&server);
    server.wait_for(PATIENCE, |said| said.contains("certificate reloaded").then_some(())).unwrap();
    assert_eq!(masks(&url).unwrap(), 1);
    assert_eq!(masks(&only(&second)).unwrap(), 1);
    masks(&only(&first)).unwrap_err();
    server.terminate().unwrap();
    server.finish(PATIENCE).unwrap().success().unwrap();
}
