//! What a calibrated receiver still lacks: the best pulse shape, its limits, and what is reported of it.

use super::{Calibrator, ResponseKey, failed, name};
use wavex_line::scan_line::Channel;
use wavex_line::stage::{Output, Result};
use wavex_signal::calibrate::response::{
    Calibrated, MIN_ECHOES, calibrate_response, comparable_height_dn, is_too_narrow, with_outgoing_pulse,
    with_response_of,
};
use wavex_signal::calibrate::{self, receiver_limits};
use wavex_signal::decompose::{OVERDRIVEN_PART, Waveform};
use wavex_signal::sensor_model::{ChannelModel, NoiseSource, ReceiverLimits, ResponseSource};

impl Calibrator {
    /// Replaces a response that is narrower than the outgoing pulse by the response of lower echoes.
    ///
    /// A receiver or digitiser that distorts its strongest echoes makes them narrower. Echoes as low
    /// as the outgoing pulses are not distorted more than these; higher ones count as overdriven.
    pub(super) fn undistorted(
        &self,
        channel: Channel,
        own: Option<Calibrated>,
        reference: &Option<Calibrated>,
        out: &mut Output,
    ) -> Result<Option<Calibrated>> {
        let (Some(found), Some(outgoing)) = (&own, reference) else { return Ok(own) };
        let gain_changes = self.gain_changes(channel);
        // Clipped outgoing pulses are too wide, and heights of different gains are not comparable.
        let is_comparable =
            outgoing.model.response.is_some() && !gain_changes && !self.is_outgoing_pulse_clipped();
        if !is_comparable || !is_too_narrow(&found.model, &outgoing.model) {
            return Ok(own);
        }
        let [width_ns, outgoing_ns] = [&found.model, &outgoing.model].map(|model| model.pulse_fwhm_ns);
        let contradiction = format!(
            "{}: the response of its echoes is {width_ns:.2} ns wide, and the outgoing pulse {outgoing_ns:.2} ns: \
             the receiver or its digitiser distorts strong echoes",
            name(channel)
        );
        let limit_dn = comparable_height_dn(self.blocks(Channel::Reference), &outgoing.model);
        let settings = self.settings(channel);
        let lower = limit_dn.map(|limit_dn| {
            let limits = ReceiverLimits { overdriven_dn: Some(limit_dn), ..found.model.limits };
            let start = ChannelModel { limits, pulse_fwhm_ns: outgoing_ns, ..found.model.clone() };
            self.in_pool(|| calibrate_response(self.blocks(channel), &start, &settings))
        });
        let lower = lower.transpose().map_err(|error| failed(channel, &error))?;
        match lower.zip(limit_dn) {
            Some((lower, limit_dn))
                if lower.model.response.is_some() && !is_too_narrow(&lower.model, &outgoing.model) =>
            {
                out.cx.warn(format!(
                    "{contradiction}; the response is that of echoes up to {limit_dn:.0} DN, {:.2} ns wide, and \
                     higher ones are flagged as overdriven, with larger standard deviations",
                    lower.model.pulse_fwhm_ns
                ));
                Ok(Some(lower))
            }
            _ => {
                out.cx.warn(format!("{contradiction}; the outgoing pulse is used as response"));
                Ok(own)
            }
        }
    }

    /// Uses the outgoing pulse as the response of a receiver if it explains the echoes better.
    ///
    /// A clipped outgoing pulse has lost its shape, and gains that change would need their own
    /// comparison.
    pub(super) fn with_outgoing_pulse(
        &self,
        channel: Channel,
        own: Option<Calibrated>,
        reference: &Option<Calibrated>,
        out: &mut Output,
    ) -> Result<Option<Calibrated>> {
        let (Some(own), Some(reference)) = (&own, reference) else { return Ok(own) };
        let gain_changes = self.gain_changes(channel);
        if self.config.response == ResponseKey::Gaussian || gain_changes || self.is_outgoing_pulse_clipped() {
            return Ok(Some(own.clone()));
        }
        let settings = self.settings(channel);
        let blocks = self.blocks(channel);
        let chosen = self
            .in_pool(|| with_outgoing_pulse(blocks, own, &reference.model, &settings))
            .map_err(|error| failed(channel, &error))?;
        let provenance = chosen.model.provenance;
        let [of_echoes, of_outgoing] = provenance.residual_over_peak.map(|part| 100.0 * part);
        if of_outgoing > 0.0 {
            let own_shape =
                if own.model.response.is_some() { "the response of its echoes" } else { "a Gaussian" };
            out.cx.info(format!(
                "{}: residual over peak {of_echoes:.2} % with {}, {of_outgoing:.2} % with the outgoing pulse: {} is used",
                name(channel),
                own_shape,
                if provenance.response == ResponseSource::OutgoingPulse { "the outgoing pulse" } else { own_shape },
            ));
        }
        Ok(Some(chosen))
    }

    /// Adds the measured behaviour of a receiver near full scale.
    pub(super) fn with_limits(
        &self,
        channel: Channel,
        found: Option<Calibrated>,
        out: &mut Output,
    ) -> Result<Option<Calibrated>> {
        let Some(mut found) = found else { return Ok(None) };
        let clipping_dn = self.clipping_dn(channel);
        let distorted_above_dn = found.model.limits.overdriven_dn;
        found.model.limits.full_scale_is_measured = clipping_dn.is_some();
        let gain_changes = self.gain_changes(channel);
        if found.model.response.is_some() && !gain_changes {
            let settings = self.settings(channel);
            let (blocks, model) = (self.blocks(channel), &found.model);
            found.model.limits = self
                .in_pool(|| receiver_limits(blocks, model, &settings))
                .map_err(|error| failed(channel, &error))?;
        }
        found.model.limits.is_linear &= distorted_above_dn.is_none();
        let ReceiverLimits { overdriven_dn, recovery_samples, is_linear, .. } = found.model.limits;
        // Chi-square does not show the range error of an overdriven receiver: pulses above the usual
        // limit stay flagged, and the height where it does show overdrive is only reported.
        found.model.limits.overdriven_dn = distorted_above_dn;
        let usual_dn = OVERDRIVEN_PART * found.model.full_scale_dn;
        let findings = [
            clipping_dn.map(|dn| format!("clips at {dn} DN")),
            overdriven_dn.filter(|dn| *dn < found.model.full_scale_dn).map(|dn| format!("shows overdrive by chi-square above {dn:.0} DN; pulses above {usual_dn:.0} DN stay flagged")),
            is_linear.then(|| "is linear up to full scale".to_owned()),
            recovery_samples.map(|_| "recovers at once after clipping".to_owned()),
        ];
        for finding in findings.into_iter().flatten() {
            out.cx.info(format!("{} {finding}", name(channel)));
        }
        Ok(Some(found))
    }

    /// Whether a receiver has blocks of other gains than the reference gain.
    pub(super) fn gain_changes(&self, channel: Channel) -> bool {
        self.look_ahead.recorded(channel).any(|block| block.gain != 1.0)
    }

    /// Whether more than a tenth of the outgoing pulses reach full scale.
    fn is_outgoing_pulse_clipped(&self) -> bool {
        let full_scale_dn = self.settings(Channel::Reference).full_scale_dn;
        let is_clipped = |block: &Waveform| block.samples.iter().any(|&dn| f64::from(dn) >= full_scale_dn);
        let clipped = self.blocks(Channel::Reference).filter(is_clipped).count() as u64;
        10 * clipped > self.count(Channel::Reference)
    }

    /// Reports the noise of a receiver, and warns if fourth differences contradict it.
    pub(super) fn report_noise(channel: Channel, model: &ChannelModel, out: &mut Output) {
        let measured_dn = model.provenance.noise_by_differences_dn;
        let Ok(noise) = model.noise() else { return };
        let expected_dn = noise.difference_sd();
        let source = match model.provenance.noise {
            NoiseSource::FreeSamples => "from samples before the pulses",
            NoiseSource::QuietResiduals => "from residuals where the pulses are low",
            NoiseSource::Differences => "from fourth differences, without correlation",
            NoiseSource::Residuals => "from the residuals of the pulses",
            NoiseSource::Unknown => return,
        };
        out.cx.info(format!(
            "{}: noise {:.2} DN {source}; its white part by fourth differences is {measured_dn:.2} DN, \
             {expected_dn:.2} DN expected",
            name(channel),
            model.noise_sd_dn,
        ));
        if measured_dn > 0.0 && !(0.5..2.0).contains(&(expected_dn / measured_dn)) {
            out.cx.warn(format!(
                "{}: the noise of {:.2} DN contradicts fourth differences of the samples: standard deviations \
                 may be wrong by a factor of {:.1}; calibrate from a part of the recording with longer blocks, \
                 or load a saved sensor model",
                name(channel),
                model.noise_sd_dn,
                (expected_dn / measured_dn).max(measured_dn / expected_dn),
            ));
        }
    }

    /// Completes a channel's model: without its own response, it gets the response of the other
    /// receiver, or a Gaussian.
    pub(super) fn completed(
        &self,
        channel: Channel,
        own: &Option<Calibrated>,
        other: &Option<Calibrated>,
        out: &mut Output,
    ) -> Option<ChannelModel> {
        let Calibrated { model, usable_echoes } = own.as_ref()?;
        if model.response.is_some() || self.config.response == ResponseKey::Gaussian {
            return Some(model.clone());
        }
        let borrowed = other.as_ref().and_then(|other| with_response_of(model, &other.model));
        let pulses = match &borrowed {
            Some(_) => "use the system response of the other receiver".to_owned(),
            None => format!("are modelled as Gaussians with a width of {:.2} ns", model.pulse_fwhm_ns),
        };
        out.cx.warn(format!(
            "{}: pulses {pulses}: {}",
            name(channel),
            match *usable_echoes {
                enough if enough >= MIN_ECHOES =>
                    format!("its {enough} strong single pulses do not share a common response"),
                few =>
                    format!("estimating its own response needs {MIN_ECHOES} strong single pulses, but there were {few}"),
            }
        ));
        Some(borrowed.unwrap_or_else(|| model.clone()))
    }

    /// Model of a high-power receiver with too few blocks to calibrate, whose gain and delay are known.
    pub(super) fn with_borrowed_response(
        &self,
        low: Option<&ChannelModel>,
        out: &mut Output,
    ) -> Option<ChannelModel> {
        let channel = Channel::HighPower;
        let blocks = self.count(channel);
        if blocks == 0 || !self.is_fused() {
            return None;
        }
        let gain_changes = self.gain_changes(channel);
        let model = low.filter(|_| !gain_changes).and_then(|low| {
            calibrate::with_borrowed_response(self.blocks(channel), low, &self.settings(channel))
        });
        out.cx.warn(match &model {
            None => {
                format!("{} was not calibrated and is not used: {blocks} blocks are too few", name(channel))
            }
            Some(model) => format!(
                "{} has {blocks} blocks, too few to calibrate: it has their noise of {:.2} DN and {} of {}",
                name(channel),
                model.noise_sd_dn,
                if model.response.is_some() { "the response" } else { "the Gaussian pulses" },
                name(Channel::LowPower),
            ),
        });
        model
    }
}
