//! Edits of the scene: taken, refused, told, traced; in worlds of their own, and in a shared one.

use gnomon_protocol::{
    edit::{Edit, LightEdit, NodeEdit},
    limits::MAX_EDITS,
    message::{ClientMessage, Edited, Hello, ServerMessage},
};
use gnomon_server::tokens::{self, Scope};

use super::{
    Rig,
    client::{Frames, HEIGHT, Native, WIDTH, hello},
    operator::{page, value, with_admin},
    soon,
};

/// Light `light` with another intensity.
fn dimmed(light: u32, intensity: f32) -> Edit {
    Edit::Light(LightEdit { light, intensity: Some(intensity), ..LightEdit::default() })
}

async fn edit(client: &mut Native, number: u32, edits: Vec<Edit>) {
    client.control.send(&ClientMessage::Edit { number, edits }).await;
}

/// The next message that is no clock.
async fn heard(client: &mut Native) -> Option<ServerMessage> {
    loop {
        match client.control.receive().await {
            Some(ServerMessage::Clock(_)) => {}
            other => return other,
        }
    }
}

async fn edited(client: &mut Native) -> Edited {
    match heard(client).await {
        Some(ServerMessage::Edited(edited)) => edited,
        other => panic!("{other:?}"),
    }
}

async fn lit(client: &Native, frames: &mut Frames, number: u32, light: u32) -> usize {
    let mask = client.frame(frames, number).await;
    let pixels = (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y)));
    pixels.filter(|&(x, y)| mask.get(light, x, y)).count()
}

#[tokio::test(flavor = "multi_thread")]
async fn edits_are_told_and_traced_or_refused() {
    let rig = with_admin().await;
    let mut client = Native::started(rig.address(), rig.folder.path()).await;
    let mut frames = Frames::new();
    assert!(lit(&client, &mut frames, 0, 0).await > 0);
    edit(&mut client, 5, vec![dimmed(0, 0.0)]).await;
    let told = Edited { revision: 1, yours: Some(5), whole: false, edits: vec![dimmed(0, 0.0)] };
    assert_eq!(edited(&mut client).await, told);
    assert_eq!(lit(&client, &mut frames, 1, 0).await, 0, "it is out");
    assert!(lit(&client, &mut frames, 2, 1).await > 0, "the other is not");
    let node = |node| Edit::Node(NodeEdit { node, ..NodeEdit::default() });
    let turned = LightEdit { direction: Some([0.0, f64::NAN, 1.0]), ..LightEdit::default() };
    for (number, edits) in (6..).zip([
        vec![node(0)],
        vec![dimmed(9, 1.0)],
        vec![dimmed(0, f32::NAN)],
        vec![dimmed(1, 1.0), dimmed(0, -1.0)],
        vec![Edit::Light(turned)],
        vec![Edit::Light(LightEdit { position_m: Some([1e300; 3]), ..LightEdit::default() })],
    ]) {
        edit(&mut client, number, edits).await;
        let refused = heard(&mut client).await;
        assert!(matches!(refused, Some(ServerMessage::EditRefused { number: told, .. }) if told == number));
    }
    // What is left out is as in the file again.
    edit(&mut client, 12, vec![Edit::Light(LightEdit::default())]).await;
    assert_eq!((edited(&mut client).await.revision, lit(&client, &mut frames, 3, 0).await > 0), (2, true));
    // Another client has a world of its own.
    let mut other = Native::connect(rig.address(), rig.folder.path()).await;
    let welcome = other.control.welcome(hello()).await;
    assert_eq!((welcome.revision, welcome.may_edit, welcome.shared_world), (0, true, false));
    client.control.send(&ClientMessage::Bye).await;
    rig.sessions(1).await;
    let page = page(&rig).await;
    let edits = |outcome: &str| value(&page, &format!("gnomon_edits_total{{outcome=\"{outcome}\"}}"));
    assert_eq!((edits("taken"), edits("refused")), (2, 6));
}

#[tokio::test(flavor = "multi_thread")]
async fn who_edits_too_early_or_too_much_is_sent_away() {
    let rig = Rig::start(|_, _| {}).await;
    let said = async |client: &mut Native| loop {
        match client.control.receive().await {
            Some(ServerMessage::Closing { reason, may_return }) => {
                assert!(may_return);
                return reason.to_string();
            }
            Some(ServerMessage::Edited(_)) => {}
            other => panic!("{other:?}"),
        }
    };
    let mut early = Native::connect(rig.address(), rig.folder.path()).await;
    early.control.welcome(hello()).await;
    edit(&mut early, 0, vec![dimmed(0, 1.0)]).await;
    assert!(said(&mut early).await.contains("an edit before Start"));
    let mut greedy = Native::started(rig.address(), rig.folder.path()).await;
    edit(&mut greedy, 0, vec![dimmed(0, 1.0); MAX_EDITS + 1]).await;
    assert!(said(&mut greedy).await.contains("edits"));
    // More messages than any drag makes, again and again: a busy machine may take some of them slowly. With pauses, so
    // that they are not too many bytes.
    let mut flood = Native::started(rig.address(), rig.folder.path()).await;
    let reason = 'sent_away: loop {
        for number in 0..50 {
            edit(&mut flood, number, vec![dimmed(0, 1.0)]).await;
        }
        loop {
            match flood.control.receive().await {
                Some(ServerMessage::Edited(Edited { yours: Some(49), .. })) => break,
                Some(ServerMessage::Edited(_)) => {}
                Some(ServerMessage::Closing { reason, .. }) => break 'sent_away reason.to_string(),
                other => panic!("{other:?}"),
            }
        }
        tokio::time::sleep(std::time::Duration::from_millis(50)).await;
    };
    assert!(reason.contains("edits in") || reason.contains("control messages in"), "{reason}");
}

#[tokio::test(flavor = "multi_thread")]
async fn all_see_what_one_changes_in_a_shared_world() {
    let rig = Rig::start(|config, _| config.shared_world = true).await;
    let mut one = Native::started(rig.address(), rig.folder.path()).await;
    let mut other = Native::started(rig.address(), rig.folder.path()).await;
    // Both are there before anything is changed.
    one.frame(&mut Frames::new(), 0).await;
    other.frame(&mut Frames::new(), 0).await;
    for revision in 1..=3_u32 {
        let (from, to) = if revision == 2 { (&mut other, &mut one) } else { (&mut one, &mut other) };
        let change = vec![dimmed(revision % 2, revision as f32)];
        edit(from, revision, change.clone()).await;
        let told = Edited { revision, yours: Some(revision), whole: false, edits: change };
        assert_eq!(edited(from).await, told);
        assert_eq!(edited(to).await, Edited { yours: None, ..told });
    }
    // Who comes later gets the state, and the time.
    let mut late = Native::connect(rig.address(), rig.folder.path()).await;
    let welcome = late.control.welcome(hello()).await;
    assert_eq!((welcome.revision, welcome.shared_world), (3, true));
    late.control.send(&ClientMessage::Start).await;
    let edits = vec![dimmed(0, 2.0), dimmed(1, 3.0)];
    let whole = Edited { revision: 3, yours: None, whole: true, edits };
    assert_eq!(late.control.receive().await, Some(ServerMessage::Edited(whole)));
    let Some(ServerMessage::Clock(first)) = late.control.receive().await else { panic!("no clock") };
    late.control.send(&ClientMessage::Ping(1)).await;
    assert_eq!(late.control.receive().await, Some(ServerMessage::Pong(1)));
    let Some(ServerMessage::Clock(second)) = late.control.receive().await else { panic!("no clock") };
    assert!(second >= first);
    edit(&mut one, 4, vec![dimmed(0, 0.0)]).await;
    assert_eq!((edited(&mut late).await.revision, lit(&late, &mut Frames::new(), 0, 0).await), (4, 0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_must_have_the_scope_to_edit() {
    let make = |scopes: &[Scope]| tokens::make("", None, scopes, false).unwrap();
    let (watching, editing) = (make(&[Scope::Session]), make(&[Scope::Session, Scope::Edit]));
    let list = format!("{}\n{}", watching.1, editing.1);
    let rig = Rig::start(|config, folder| {
        let file = folder.join("tokens.toml");
        std::fs::write(&file, list).unwrap();
        config.token_file = Some(file);
    })
    .await;
    for (token, may_edit) in [(watching.0, false), (editing.0, true)] {
        let mut client = Native::connect(rig.address(), rig.folder.path()).await;
        let welcome = client.control.welcome(Hello { token: Some(token.as_str().into()), ..hello() }).await;
        assert_eq!(welcome.may_edit, may_edit);
        client.control.send(&ClientMessage::Start).await;
        edit(&mut client, 0, vec![dimmed(0, 0.0)]).await;
        match soon(heard(&mut client)).await {
            Some(ServerMessage::Edited(edited)) => assert!(may_edit && edited.yours == Some(0)),
            Some(ServerMessage::EditRefused { number: 0, reason }) => {
                assert!(!may_edit && reason.to_string().contains("scope"), "{reason}");
            }
            other => panic!("{other:?}"),
        }
    }
}
