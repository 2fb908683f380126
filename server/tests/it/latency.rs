//! Figures, not judgements: `cargo test --release -p lumicast --test it latency -- --ignored --nocapture`.

use crate::harness::{Server, harmless};
use std::time::{Duration, Instant};

fn percentile(sorted: &[Duration], share: f64) -> Duration {
    sorted[((sorted.len() - 1) as f64 * share) as usize]
}

fn print(name: &str, mut times: Vec<Duration>) {
    times.sort();
    let [p50, p95, p99] = [0.5, 0.95, 0.99].map(|share| percentile(&times, share).as_secs_f64() * 1e3);
    println!("{name}: p50 {p50:.1} ms, p95 {p95:.1} ms, p99 {p99:.1} ms of {}", times.len());
}

/// From the camera message to the first frame that answers it, at the pace of a mouse.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "measures; run it alone"]
async fn latency_of_camera_and_edit() {
    let server = Server::start(|_| {}).await;
    let ready = Instant::now();
    let mut viewer = server.viewer().await;
    viewer.camera("main", [640, 360]).await;
    viewer.frame().await;
    println!("first picture: {:?} after the scene was ready", ready.elapsed());
    for millis in [16, 33, 200] {
        let mut pace = tokio::time::interval(Duration::from_millis(millis));
        pace.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        let (mut sent, mut times, mut frames, mut pixels) = (Vec::new(), Vec::new(), 0, 0_u64);
        let started = Instant::now();
        for n in 0..3000 {
            if times.len() >= 150 || started.elapsed() > Duration::from_secs(20) {
                break;
            }
            tokio::select! {
                _ = pace.tick() => sent.push((viewer.pose(f64::from(n % 100) * 0.01, [640, 360]).await, Instant::now())),
                (header, _) = viewer.frame() => {
                    frames += 1;
                    pixels += u64::from(header.size[0]) * u64::from(header.size[1]);
                    if header.first_from_stamp {
                        // Every camera up to this one is answered; the one drawn is the one whose latency counts.
                        let own = sent.iter().find(|(stamp, _)| *stamp == header.camera_stamp);
                        times.extend(own.map(|(_, at)| at.elapsed()));
                        sent.retain(|(stamp, _)| *stamp > header.camera_stamp);
                    }
                }
            }
        }
        let seconds = started.elapsed().as_secs_f64();
        println!(
            "camera every {millis} ms: {:.1} frames/s, mean {} pixels",
            f64::from(frames) / seconds,
            pixels / frames.max(1) as u64
        );
        print("  camera → frame", times);
    }
    let mut times = Vec::new();
    for n in 0..40 {
        let sent = Instant::now();
        let revision = server.edit(harmless(f64::from(n) * 0.01)).await.revision();
        viewer.frame_where(|header| header.revision >= revision).await;
        times.push(sent.elapsed());
    }
    print("edit → picture", times);
    server.stop().await;
}
