//! `lab link`: the network emulator as a program, for a client and a server that are started by hand.

use std::{net::SocketAddr, time::Duration};

use anyhow::{Context, Result};

use crate::link::{Counts, LinkCounts, LinkSettings, profiles::Profile, server};

#[derive(Debug, Clone, clap::Args)]
pub struct LinkOptions {
    /// Loopback address for clients; port 0 takes a free one.
    #[arg(long, default_value = "127.0.0.1:0")]
    pub listen: SocketAddr,
    /// The server on this machine: its printed URL, or ADDRESS:PORT of anything that speaks UDP.
    #[arg(long)]
    pub server: String,
    /// The network: lan, wifi, 5g, lte, bad or outage.
    #[arg(long, default_value = "wifi")]
    pub profile: String,
    /// Changes to both directions, in the format of the printed profiles: "delay=50ms loss=1% outage=5s+2s".
    #[arg(long, default_value = "", hide_default_value = true)]
    pub both: String,
    /// Changes from client to server.
    #[arg(long, default_value = "", hide_default_value = true)]
    pub up: String,
    /// Changes from server to client.
    #[arg(long, default_value = "", hide_default_value = true)]
    pub down: String,
    /// Seed of all random decisions; the same seed gives the same fates.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Seconds until the link ends [default: at Ctrl-C].
    #[arg(long)]
    pub seconds: Option<f64>,
}

impl LinkOptions {
    pub fn settings(&self) -> Result<LinkSettings> {
        let mut settings = Profile::named(&self.profile)?.settings(self.seed)?;
        settings.up.set(&format!("{} {}", self.both, self.up)).context("from client to server")?;
        settings.down.set(&format!("{} {}", self.both, self.down)).context("from server to client")?;
        Ok(settings)
    }
}

/// Runs the link to its end. `say` gets the settings, the address to connect to, and at last the counters.
pub fn run(options: &LinkOptions, mut say: impl FnMut(&str)) -> Result<LinkCounts> {
    let settings = options.settings()?;
    let seconds = options.seconds.map(Duration::try_from_secs_f64).transpose().context("--seconds")?;
    say(&format!("{}, seed {}", options.profile, options.seed));
    say(&format!("up:   {}", settings.up));
    say(&format!("down: {}", settings.down));
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    runtime.block_on(async {
        let link = server::start(options.listen, &options.server, settings).await?;
        say(&link.url(&options.server)?);
        let end = async {
            match seconds {
                Some(seconds) => tokio::time::sleep(seconds).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            () = end => {}
            interrupted = tokio::signal::ctrl_c() => interrupted.context("waiting for Ctrl-C")?,
        }
        let counts = link.counts();
        say(&format!("up:   {}", describe(&counts.up)));
        say(&format!("down: {}", describe(&counts.down)));
        if counts.refused > 0 {
            say(&format!("{} datagrams or connections of more clients than fit were refused", counts.refused));
        }
        Ok(counts)
    })
}

fn describe(counts: &Counts) -> String {
    let Counts {
        arrived,
        delivered,
        lost,
        burst_lost,
        queue_dropped,
        too_large,
        outage,
        corrupted,
        duplicated,
        reordered,
        overrun,
    } = counts;
    format!(
        "{arrived} arrived, {delivered} delivered ({corrupted} corrupted, {duplicated} duplicated, \
         {reordered} held back), {lost} lost, {burst_lost} lost in bursts, {queue_dropped} dropped by the queue, \
         {too_large} too large, {outage} lost in outages, {overrun} beyond the link's memory"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::scene_args::parse;

    fn parsed(line: &str) -> Result<LinkSettings> {
        parse::<LinkOptions>(&format!("--server 127.0.0.1:9 {line}"))?.settings()
    }

    #[test]
    fn changes_go_before_the_profile_and_one_direction_before_both() {
        let settings = parsed("--profile lte --both loss=5%,delay=50ms --down loss=6% --seed 9").unwrap();
        assert_eq!((settings.up.loss, settings.down.loss, settings.seed), (0.05, 0.06, 9));
        assert_eq!((settings.up.delay.as_millis(), settings.up.jitter.as_millis()), (50, 10));
        assert!(parsed("--profile moon").unwrap_err().to_string().contains("no profile"));
        assert!(format!("{:#}", parsed("--up loss=5").unwrap_err()).contains("client to server: loss=5"));
    }

    #[test]
    fn only_loopback_is_linked() {
        let options = |server: &str, listen: &str| {
            run(&parse(&format!("--server {server} --listen {listen} --seconds 0")).unwrap(), |_| {})
        };
        assert_eq!(options("127.0.0.1:9", "127.0.0.1:0").unwrap(), LinkCounts::default());
        for (server, listen) in [
            ("192.0.2.1:9", "127.0.0.1:0"),
            ("gnomon://192.0.2.1:9/?cert=00", "127.0.0.1:0"),
            ("gnomon://edge.example:9/?cert=00", "127.0.0.1:0"),
            ("gnomon+lab-udp://[2001:db8::1]:9", "[::1]:0"),
            ("127.0.0.1:9", "0.0.0.0:0"),
        ] {
            let error = format!("{:#}", options(server, listen).unwrap_err());
            assert!(error.contains("loopback"), "{server} {listen}: {error}");
        }
        assert!(
            options("gnomon+lab-tcp://127.0.0.1:9", "127.0.0.1:0").unwrap_err().to_string().contains("no datagrams")
        );
    }
}
