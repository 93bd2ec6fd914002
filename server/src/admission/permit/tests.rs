//! Permits without clients.

use gnomon_protocol::{codec::CodecId, mask::MaskShape};

use super::*;
use crate::{
    admission::{
        capacity::{Demand, HostCapacity},
        coding::Coding,
    },
    config::ServerConfig,
};

fn holding(token: Option<Digest>) -> Holding {
    let shape = MaskShape::new(8, 8, 1).unwrap();
    let capacity = HostCapacity::new(&ServerConfig::default(), 1, 0, 0);
    let demand = Demand { shape, coding: Coding { codec: CodecId::PlanesLz4, wrong_ppm: 0 }, rate_hz: None };
    Holding {
        token,
        address: Arc::default(),
        costs: Arc::new(SessionCosts::new(shape, None, 1.0)),
        share: capacity.reserve(demand, None).unwrap().share(),
    }
}

fn acquire(permits: &SessionPermits, resume: Option<ResumeToken>) -> Result<SessionPermit, Refusal> {
    let claim = permits.claim(resume, None)?;
    permits.register(permits.place(claim.as_ref())?, holding(None), claim)
}

#[test]
fn a_dropped_permit_is_free_again() {
    let permits = SessionPermits::new(2);
    let (first, second) = (acquire(&permits, None).unwrap(), acquire(&permits, None).unwrap());
    assert_ne!(first.id, second.id);
    assert_eq!(acquire(&permits, None).unwrap_err(), Refusal::Full { sessions: 2, retry_after_ms: 5000 });
    assert_eq!(permits.in_use(), 2);
    drop(first);
    assert_eq!(permits.in_use(), 1);
    let third = acquire(&permits, None).unwrap();
    assert_ne!(third.id, second.id);
    permits.close();
    drop(third);
    assert_eq!(acquire(&permits, None).unwrap_err(), Refusal::Draining);
    assert_eq!(acquire(&permits, Some(second.resume)).unwrap_err(), Refusal::Draining);
    assert_eq!(permits.in_use(), 1, "an admitted session keeps its permit");
}

#[tokio::test]
async fn a_resume_token_takes_its_session_over_once() {
    let permits = SessionPermits::new(1);
    let mut lost = acquire(&permits, None).unwrap();
    let stranger = Some(ResumeToken([1; 16]));
    assert!(matches!(acquire(&permits, stranger), Err(Refusal::Full { .. })));
    let token = lost.resume;
    let mut back = acquire(&permits, Some(token)).unwrap();
    assert!(matches!(acquire(&permits, Some(token)), Err(Refusal::Full { .. })), "it is claimed");
    back.take_over();
    assert_eq!(lost.ended().await, EndReason::Superseded);
    assert!(back.resume != token && back.id != lost.id);
    assert_eq!(permits.in_use(), 1);
    assert!(matches!(acquire(&permits, Some(token)), Err(Refusal::Full { .. })), "a resume token works once");
    drop(lost);
    assert_eq!(permits.in_use(), 1, "the permit is the new session's");
    drop(back);
    assert_eq!(permits.in_use(), 0);
    assert!(permits.state.lock().sessions.is_empty());
}

#[tokio::test]
async fn a_claim_that_is_given_back_changes_nothing() {
    let permits = SessionPermits::new(1);
    let mut old = acquire(&permits, None).unwrap();
    // Refused after the claim, and after it was registered.
    drop(permits.claim(Some(old.resume), None).unwrap().unwrap());
    drop(acquire(&permits, Some(old.resume)).unwrap());
    assert!(old.ended.borrow().is_none() && permits.in_use() == 1);
    // The old session may end first.
    let mut back = acquire(&permits, Some(old.resume)).unwrap();
    drop(old);
    back.take_over();
    assert!(back.ended.borrow().is_none() && permits.in_use() == 1);
    old = acquire(&permits, Some(back.resume)).unwrap();
    old.take_over();
    assert_eq!(back.ended().await, EndReason::Superseded);
}

#[test]
fn only_the_token_that_opened_a_session_resumes_it() {
    let permits = SessionPermits::new(2);
    let open = permits.register(permits.place(None).unwrap(), holding(Some([1; 32])), None).unwrap();
    for other in [None, Some([2; 32])] {
        assert!(permits.claim(Some(open.resume), other).unwrap().is_none());
    }
    assert!(permits.claim(Some(open.resume), Some([1; 32])).unwrap().is_some());
}

#[tokio::test]
async fn an_ended_session_is_told_why_and_does_not_come_back_at_once() {
    let permits = SessionPermits::new(2);
    let (mut first, mut second) = (acquire(&permits, None).unwrap(), acquire(&permits, None).unwrap());
    assert!(!permits.end(SessionId(99), EndReason::Operator));
    assert!(permits.end(first.id, EndReason::Operator));
    assert!(!permits.end(first.id, EndReason::Operator), "it is over");
    assert_eq!(first.ended().await, EndReason::Operator);
    let refused = acquire(&permits, Some(first.resume)).unwrap_err();
    assert!(refused.to_string().contains("the operator ended this session"), "{refused}");
    assert!(refused.retry_after().unwrap() > DISMISSED_FOR / 2);
    // Ended while its client resumes it.
    let mut back = acquire(&permits, Some(second.resume)).unwrap();
    assert!(permits.end(second.id, EndReason::Operator));
    back.take_over();
    assert_eq!((second.ended().await, back.ended().await), (EndReason::Operator, EndReason::Operator));
    assert!(acquire(&permits, Some(back.resume)).is_err());
    // The memory of them is bounded and fades.
    let mut state = permits.state.lock();
    let now = Instant::now();
    for number in 0..=MAX_DISMISSED {
        state.dismiss(ResumeToken([u8::try_from(number % 256).unwrap(); 16]), now);
    }
    assert_eq!(state.dismissed.len(), MAX_DISMISSED);
    assert_eq!(state.dismissed_for(ResumeToken([7; 16]), now + DISMISSED_FOR * 2), None);
    assert!(state.dismissed.is_empty());
}
