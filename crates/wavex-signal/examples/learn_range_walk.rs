//! Learns range walks from text, for checks by other programs.
//!
//! Each line of the standard input has the number of a shot and the time of flight, ns, its standard
//! deviation, ns, and the amplitude, DN, of its single echo. A line `end` ends a recording; shots of
//! different scan lines are at least 1000 apart. Prints one line of JSON per recording: `proven`,
//! `reason` if it is not, and the `walk` if there is one.

use std::io::{BufRead, Write};

use wavex_returns::range_walk::{RangeWalk, SingleEcho, Triple};

fn main() -> std::io::Result<()> {
    let mut echoes: Vec<(u64, SingleEcho)> = Vec::new();
    let mut out = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        if line != "end" {
            let numbers: Vec<f64> = line.split(' ').filter_map(|number| number.parse().ok()).collect();
            if let [shot, flight_ns, flight_sd_ns, amplitude_dn] = numbers[..] {
                echoes.push((shot as u64, SingleEcho { flight_ns, flight_sd_ns, amplitude_dn }));
            }
            continue;
        }
        let triple = |of: &[(u64, SingleEcho)]| match *of {
            [(first, a), (shot, b), (last, c)] => {
                (shot == first + 1 && last == shot + 1).then_some(Triple { echoes: [a, b, c], shot })
            }
            _ => None,
        };
        let triples: Vec<Triple> = echoes.windows(3).filter_map(triple).collect();
        echoes.clear();
        match RangeWalk::learn(&triples, None) {
            Ok(learnt) => {
                let refusal = learnt.proof.refusal();
                let reason = refusal.map(|refusal| refusal.to_string()).unwrap_or_default();
                let walk = serde_json::to_string(&learnt.walk)?;
                writeln!(
                    out,
                    "{{\"proven\": {}, \"reason\": {reason:?}, \"walk\": {walk}}}",
                    refusal.is_none()
                )?;
            }
            Err(reason) => writeln!(out, "{{\"proven\": false, \"reason\": {:?}}}", reason.to_string())?,
        }
    }
    Ok(())
}
