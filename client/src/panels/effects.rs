//! Which parts of the renderer the scene needs, and why: the server's `GET /v1/scenes/{id}/effects`.

use super::accuracy::choice;
use crate::model::Model;
use crate::theme;
use egui::{RichText, Ui};
use lumicast_protocol::{EffectChoice, Effects};
use std::sync::mpsc::{Receiver, TryRecvError};

/// The answer to the last question, and the question on its way.
#[derive(Default)]
pub struct EffectsPanel {
    answer: Option<Result<Effects, String>>,
    asked_for: Option<u64>,
    pending: Option<Receiver<Result<String, String>>>,
}

impl EffectsPanel {
    /// Takes an answer that has come. Returns whether to ask for this revision now.
    pub fn wants(&mut self, revision: u64) -> bool {
        if let Some(pending) = &self.pending {
            let body = match pending.try_recv() {
                Ok(body) => body,
                Err(TryRecvError::Empty) => return false,
                Err(TryRecvError::Disconnected) => Err("no answer".into()),
            };
            self.pending = None;
            self.answer =
                Some(body.and_then(|body| serde_json::from_str(&body).map_err(|error| error.to_string())));
        }
        self.asked_for != Some(revision)
    }

    /// The question was put.
    pub fn asked(&mut self, revision: u64, answer: Receiver<Result<String, String>>) {
        (self.asked_for, self.pending) = (Some(revision), Some(answer));
    }

    /// The whole panel. Effects that are computed by themselves can be chosen for this viewer.
    pub fn show(&self, ui: &mut Ui, model: &mut Model) {
        let mut accuracy = model.accuracy();
        match &self.answer {
            None => drop(ui.label(RichText::new("Asking the server …").color(theme::WEAK))),
            Some(Err(reason)) => {
                ui.label(RichText::new("The server does not tell.").color(theme::WEAK)).on_hover_text(reason);
            }
            Some(Ok(effects)) => effects.effects.iter().for_each(|effect| {
                let (sign, colour) = if effect.on { ("on", theme::GOOD) } else { ("off", theme::WEAK) };
                ui.horizontal(|ui| {
                    ui.label(RichText::new(sign).small().color(colour));
                    ui.label(&effect.effect);
                    if let Some(chosen) = accuracy.effects.choice_mut(&effect.effect) {
                        choice(ui, &effect.effect, chosen, &EffectChoice::ALL, choice_name)
                            .on_hover_text(CHOOSING);
                    }
                });
                ui.label(RichText::new(&effect.reason).small().color(theme::WEAK));
            }),
        }
        model.set_accuracy(accuracy);
    }
}

const CHOOSING: &str = "For this viewer alone. Off: pictures lack that light, and their error is measured without it. \
                        On: computed though the scene does not call for it; that costs time and changes nothing.";

fn choice_name(choice: EffectChoice) -> &'static str {
    match choice {
        EffectChoice::Auto => "As the scene needs",
        EffectChoice::On => "Always",
        EffectChoice::Off => "Never",
    }
}
