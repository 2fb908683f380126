//! Editing: what a person has changed and the server has not confirmed, in an order the server can follow.
//!
//! Newest wins and one batch is in flight: dragging a slider makes a draft; whenever the answer to the last batch has
//! come, the drafts that changed meanwhile go out together. A draft is shown in place of the scene's value until the
//! scene has caught up, so that a slider never jumps back under the hand.

use lumicast_protocol::{Change, edit};
use lumicast_protocol::{
    Edit, EditRequest, EnvironmentDescription, Id, LightSource, MaterialProperties, Problem,
    SceneDescription, SetEnvironment, SetLight, SetMaterial, SetTransform, Transform,
};
use std::collections::{BTreeMap, VecDeque};

/// At most so often goes a batch out, even if answers come faster: more than the eye follows, less than the server's
/// limit of messages.
const BATCH_INTERVAL_S: f64 = 1.0 / 30.0;
/// Changes to one thing closer together than this are one step of undo: a drag, or a few clicks on an arrow.
const GESTURE_GAP_S: f64 = 0.8;
/// Steps of undo.
const UNDO_MAX: usize = 200;
/// Things made and removed that wait to be sent; a person cannot click faster than the server answers.
const COMMANDS_MAX: usize = 32;
/// Refusals kept to be shown beside their editors.
const PROBLEMS_MAX: usize = 32;

/// A thing that can be edited.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Target {
    /// A node's transform.
    Node(Id),
    /// A material.
    Material(Id),
    /// A light.
    Light(Id),
    /// What is seen where no surface is.
    Environment,
}

/// Its editable state.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs, reason = "one per target")]
pub enum Value {
    Transform(Transform),
    Material(MaterialProperties),
    Light(LightSource),
    Environment(EnvironmentDescription),
}

impl Value {
    /// What the scene says; `None` when there is no such thing in it.
    pub fn in_scene(scene: &SceneDescription, target: &Target) -> Option<Self> {
        match target {
            Target::Node(id) => {
                scene.nodes.iter().find(|node| node.id == *id).map(|node| Self::Transform(node.transform))
            }
            Target::Material(id) => {
                let found = scene.materials.iter().find(|material| material.id == *id);
                found.map(|material| Self::Material(material.properties))
            }
            Target::Light(id) => {
                scene.lights.iter().find(|light| light.id == *id).map(|light| Self::Light(light.source))
            }
            Target::Environment => Some(Self::Environment(scene.environment)),
        }
    }
}

/// The smallest edit that takes `target` from one value to another; `None` when there is nothing to do or no edit for
/// it (a viewer does not have the texels of an environment picture).
pub fn edit_between(target: &Target, from: &Value, to: &Value) -> Option<Edit> {
    if from == to {
        return None;
    }
    match (target, from, to) {
        (Target::Node(node), _, Value::Transform(transform)) => {
            Some(Edit::SetTransform(SetTransform { node: node.clone(), transform: *transform }))
        }
        (Target::Material(id), Value::Material(from), Value::Material(to)) => {
            Some(Edit::SetMaterial(Box::new(material_edit(id, from, to))))
        }
        (Target::Light(id), Value::Light(from), Value::Light(to)) => {
            Some(Edit::SetLight(light_edit(id, from, to)))
        }
        (Target::Environment, _, Value::Environment(environment)) => match environment {
            EnvironmentDescription::None => Some(Edit::SetEnvironment(SetEnvironment::None {})),
            EnvironmentDescription::Constant { radiance } => {
                Some(Edit::SetEnvironment(SetEnvironment::Constant { radiance: *radiance }))
            }
            EnvironmentDescription::Image { .. } => None,
        },
        _ => None,
    }
}

fn changed<T: PartialEq + Copy>(from: &T, to: &T) -> Option<T> {
    (from != to).then_some(*to)
}

fn changed_option<T: PartialEq + Copy>(from: &Option<T>, to: &Option<T>) -> Change<T> {
    match to {
        _ if from == to => Change::Keep,
        Some(value) => Change::Set(*value),
        None => Change::Clear,
    }
}

fn material_edit(id: &Id, from: &MaterialProperties, to: &MaterialProperties) -> edit::SetMaterial {
    SetMaterial {
        base_color: changed(&from.base_color, &to.base_color),
        metallic: changed(&from.metallic, &to.metallic),
        roughness: changed(&from.roughness, &to.roughness),
        ior: changed(&from.ior, &to.ior),
        specular: changed(&from.specular, &to.specular),
        specular_color: changed(&from.specular_color, &to.specular_color),
        transmission: changed(&from.transmission, &to.transmission),
        attenuation_color: changed(&from.attenuation_color, &to.attenuation_color),
        attenuation_distance_m: changed_option(&from.attenuation_distance_m, &to.attenuation_distance_m),
        emission: changed(&from.emission, &to.emission),
        double_sided: changed(&from.double_sided, &to.double_sided),
        unlit: changed(&from.unlit, &to.unlit),
        alpha_cutoff: changed_option(&from.alpha_cutoff, &to.alpha_cutoff),
        normal_scale: changed(&from.normal_scale, &to.normal_scale),
        ..SetMaterial::of(id.clone())
    }
}

fn light_edit(id: &Id, from: &LightSource, to: &LightSource) -> SetLight {
    let mut edit = SetLight::of(id.clone());
    match (from, to) {
        (
            LightSource::Point { intensity: from_intensity, position: from_position },
            LightSource::Point { intensity, position },
        ) => {
            edit.intensity = changed(from_intensity, intensity);
            edit.position = changed(from_position, position);
        }
        (
            LightSource::Spot {
                intensity: from_intensity,
                position: from_position,
                direction: from_direction,
                inner_angle_rad: from_inner,
                outer_angle_rad: from_outer,
            },
            LightSource::Spot { intensity, position, direction, inner_angle_rad, outer_angle_rad },
        ) => {
            edit.intensity = changed(from_intensity, intensity);
            edit.position = changed(from_position, position);
            edit.direction = changed(from_direction, direction);
            edit.inner_angle_rad = changed(from_inner, inner_angle_rad);
            edit.outer_angle_rad = changed(from_outer, outer_angle_rad);
        }
        (
            LightSource::Directional { irradiance: from_irradiance, direction: from_direction },
            LightSource::Directional { irradiance, direction },
        ) => {
            edit.irradiance = changed(from_irradiance, irradiance);
            edit.direction = changed(from_direction, direction);
        }
        // A light keeps its kind for life; the server says so if someone tries.
        (_, to) => edit.kind = Some(to.kind()),
    }
    edit
}

/// A value that the scene does not have yet.
#[derive(Debug, Clone)]
struct Draft {
    value: Value,
    /// The value the server has or is about to have; `None`: the scene's.
    sent: Option<Value>,
    /// `value` has not been sent.
    dirty: bool,
    /// The revision that `sent` made.
    revision: Option<u64>,
}

/// A step back and forth.
#[derive(Debug, Clone)]
enum Step {
    Value { target: Target, before: Value, after: Value },
    Command { forth: Edit, back: Edit },
}

#[derive(Debug, Clone)]
struct InFlight {
    request: u64,
    edits: Vec<Edit>,
    /// Whose edit each is; `None` for a command.
    targets: Vec<Option<Target>>,
    sent_s: f64,
    /// The connection broke: to be repeated with the same key.
    repeat: bool,
}

/// What the newest answer said, for the editors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Confirmed {
    /// The batch's number.
    pub request: u64,
    /// The revision it made.
    pub revision: u64,
}

/// All that is being edited.
#[derive(Debug, Clone)]
pub struct Edits {
    session: u64,
    drafts: BTreeMap<Target, Draft>,
    commands: VecDeque<Edit>,
    in_flight: Option<InFlight>,
    problems: VecDeque<(Target, Problem)>,
    undo: VecDeque<Step>,
    redo: Vec<Step>,
    gesture_s: f64,
    last_sent_s: f64,
    request_count: u64,
    confirmed: Option<Confirmed>,
}

impl Edits {
    /// Nothing edited. `session` is random: it keeps the idempotency keys of two viewers apart.
    pub fn new(session: u64) -> Self {
        Self {
            session,
            drafts: BTreeMap::new(),
            commands: VecDeque::new(),
            in_flight: None,
            problems: VecDeque::new(),
            undo: VecDeque::new(),
            redo: Vec::new(),
            gesture_s: f64::NEG_INFINITY,
            last_sent_s: f64::NEG_INFINITY,
            request_count: 0,
            confirmed: None,
        }
    }

    /// What an editor shows: the draft, else what the scene says.
    pub fn value(&self, scene: &SceneDescription, target: &Target) -> Option<Value> {
        let in_scene = Value::in_scene(scene, target)?;
        Some(self.drafts.get(target).map_or(in_scene, |draft| draft.value))
    }

    /// A person changes a value.
    pub fn change(&mut self, scene: &SceneDescription, target: &Target, value: Value, now_s: f64) {
        let Some(before) = self.value(scene, target).filter(|before| *before != value) else { return };
        self.redo.clear();
        let undoable = edit_between(target, &value, &before).is_some();
        let same_gesture = now_s - self.gesture_s < GESTURE_GAP_S;
        match self.undo.back_mut() {
            Some(Step::Value { target: last, after, .. }) if last == target && same_gesture => *after = value,
            _ if undoable => self.push_step(Step::Value { target: target.clone(), before, after: value }),
            _ => {}
        }
        self.gesture_s = now_s;
        self.draft(target, value);
    }

    /// A person makes or removes something. `back` is the edit that undoes it.
    pub fn command(&mut self, forth: Edit, back: Option<Edit>) {
        if self.commands.len() >= COMMANDS_MAX {
            return;
        }
        self.redo.clear();
        if let Some(back) = back {
            self.push_step(Step::Command { forth: forth.clone(), back });
        }
        self.commands.push_back(forth);
    }

    fn push_step(&mut self, step: Step) {
        self.undo.push_back(step);
        if self.undo.len() > UNDO_MAX {
            self.undo.pop_front();
        }
    }

    fn draft(&mut self, target: &Target, value: Value) {
        self.problems.retain(|(of, _)| of != target);
        let draft = self.drafts.entry(target.clone()).or_insert(Draft {
            value,
            sent: None,
            dirty: true,
            revision: None,
        });
        (draft.value, draft.dirty) = (value, true);
    }

    /// Whether there is something to take back.
    pub fn can_undo(&self) -> bool {
        !self.undo.is_empty()
    }

    /// Whether something was taken back.
    pub fn can_redo(&self) -> bool {
        !self.redo.is_empty()
    }

    /// Sends the previous value again.
    pub fn undo(&mut self) {
        let Some(step) = self.undo.pop_back() else { return };
        match &step {
            Step::Value { target, before, .. } => self.draft(&target.clone(), *before),
            Step::Command { back, .. } => self.commands.push_back(back.clone()),
        }
        self.gesture_s = f64::NEG_INFINITY;
        self.redo.push(step);
    }

    /// Takes the last undo back.
    pub fn redo(&mut self) {
        let Some(step) = self.redo.pop() else { return };
        match &step {
            Step::Value { target, after, .. } => self.draft(&target.clone(), *after),
            Step::Command { forth, .. } => self.commands.push_back(forth.clone()),
        }
        self.gesture_s = f64::NEG_INFINITY;
        self.undo.push_back(step);
    }

    /// The batch to send now, if any.
    pub(super) fn next_request(&mut self, scene: &SceneDescription, now_s: f64) -> Option<EditRequest> {
        if let Some(in_flight) = &mut self.in_flight {
            let repeat = std::mem::take(&mut in_flight.repeat);
            return repeat.then(|| request(self.session, in_flight));
        }
        if now_s - self.last_sent_s < BATCH_INTERVAL_S {
            return None;
        }
        let mut edits: Vec<(Option<Target>, Edit)> =
            self.commands.drain(..).map(|command| (None, command)).collect();
        for (target, draft) in self.drafts.iter_mut().filter(|(_, draft)| draft.dirty) {
            draft.dirty = false;
            // Things that someone else removed have no value to start from: their drafts end below.
            let Some(from) = draft.sent.or_else(|| Value::in_scene(scene, target)) else { continue };
            if let Some(edit) = edit_between(target, &from, &draft.value) {
                (draft.sent, draft.revision) = (Some(draft.value), None);
                edits.push((Some(target.clone()), edit));
            }
        }
        // What needed no edit is what the scene has.
        self.drafts.retain(|_, draft| draft.sent.is_some());
        if edits.is_empty() {
            return None;
        }
        self.request_count += 1;
        self.last_sent_s = now_s;
        let (targets, edits) = edits.into_iter().unzip();
        let in_flight =
            InFlight { request: self.request_count, edits, targets, sent_s: now_s, repeat: false };
        let request = request(self.session, &in_flight);
        self.in_flight = Some(in_flight);
        Some(request)
    }

    /// When [`Edits::next_request`] will have something that it held back; `None` when nothing waits for time.
    pub(super) fn due_s(&self) -> Option<f64> {
        let waiting = !self.commands.is_empty() || self.drafts.values().any(|draft| draft.dirty);
        let repeat = self.in_flight.as_ref().is_some_and(|in_flight| in_flight.repeat);
        if repeat {
            return Some(f64::NEG_INFINITY);
        }
        (waiting && self.in_flight.is_none()).then_some(self.last_sent_s + BATCH_INTERVAL_S)
    }

    /// The server made a revision of a batch. Returns when the batch was sent.
    pub(super) fn edited(&mut self, request: u64, revision: u64, scene_revision: u64) -> Option<f64> {
        let done = self.in_flight.take_if(|in_flight| in_flight.request == request)?;
        self.confirmed = Some(Confirmed { request, revision });
        for target in done.targets.iter().flatten() {
            if let Some(draft) = self.drafts.get_mut(target) {
                draft.revision = Some(revision);
            }
        }
        self.scene_arrived(scene_revision);
        Some(done.sent_s)
    }

    /// The server refused a batch: nothing of it happened, the editors go back to what the scene says. Returns whether
    /// the fault stands beside an editor.
    pub(super) fn refused(&mut self, request: u64, problem: &Problem) -> bool {
        let Some(done) = self.in_flight.take_if(|in_flight| in_flight.request == request) else {
            return false;
        };
        for target in done.targets.iter().flatten() {
            if let Some(draft) = self.drafts.get_mut(target) {
                draft.sent = None;
            }
        }
        self.drafts.retain(|_, draft| draft.dirty || draft.sent.is_some());
        let index = problem.op_index.map_or(0, |index| index as usize);
        let Some(Some(target)) = done.targets.get(index) else { return false };
        self.problems.retain(|(of, _)| of != target);
        self.problems.push_back((target.clone(), problem.clone()));
        if self.problems.len() > PROBLEMS_MAX {
            self.problems.pop_front();
        }
        true
    }

    /// The scene came anew: drafts that it contains are done.
    pub(super) fn scene_arrived(&mut self, revision: u64) {
        self.drafts.retain(|_, draft| {
            let in_scene = draft.revision.is_some_and(|made| made <= revision);
            if in_scene && draft.dirty {
                // The base of the next edit is the scene again.
                (draft.sent, draft.revision) = (None, None);
            }
            draft.dirty || !in_scene
        });
    }

    /// A new connection: what was in flight is repeated, what was confirmed is in the scene that comes.
    pub(super) fn reconnected(&mut self) {
        if let Some(in_flight) = &mut self.in_flight {
            in_flight.repeat = true;
        }
        let flying: Vec<Target> =
            self.in_flight.iter().flat_map(|in_flight| in_flight.targets.iter().flatten().cloned()).collect();
        self.drafts.retain(|target, draft| {
            let in_flight = flying.contains(target);
            if !in_flight {
                (draft.sent, draft.revision) = (None, None);
            }
            draft.dirty || in_flight
        });
    }

    /// Why the last edit of this thing was refused.
    pub fn problem(&self, target: &Target) -> Option<&Problem> {
        self.problems.iter().find(|(of, _)| of == target).map(|(_, problem)| problem)
    }

    /// Whether the server has yet to answer for this thing.
    pub fn is_pending(&self, target: &Target) -> bool {
        self.drafts.get(target).is_some_and(|draft| draft.revision.is_none())
    }

    /// Whether anything is still to be sent or answered.
    pub fn is_busy(&self) -> bool {
        self.in_flight.is_some() || !self.commands.is_empty() || self.drafts.values().any(|draft| draft.dirty)
    }

    /// The newest answer.
    pub fn confirmed(&self) -> Option<Confirmed> {
        self.confirmed
    }
}

fn request(session: u64, in_flight: &InFlight) -> EditRequest {
    EditRequest {
        request: in_flight.request,
        if_match: None,
        idempotency_key: Some(format!("{session:016x}-{}", in_flight.request)),
        edits: in_flight.edits.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::tests::scene;
    use lumicast_protocol::ProblemKind;

    fn lamp() -> Target {
        Target::Light(Id::new("lamp").unwrap())
    }

    fn with_intensity(intensity: f32) -> Value {
        Value::Light(LightSource::Point { intensity: [intensity; 3], position: [0.0, 1.8, 0.0] })
    }

    fn intensity_sent(request: &EditRequest) -> f32 {
        let [Edit::SetLight(edit)] = request.edits.as_slice() else { panic!("{request:?}") };
        edit.intensity.unwrap()[0]
    }

    #[test]
    fn one_batch_is_in_flight_and_the_newest_value_wins() {
        let scene = scene(1);
        let mut edits = Edits::new(1);
        edits.change(&scene, &lamp(), with_intensity(20.0), 0.0);
        let first = edits.next_request(&scene, 0.0).unwrap();
        assert_eq!(intensity_sent(&first), 20.0);
        for step in 1..=10 {
            edits.change(&scene, &lamp(), with_intensity(20.0 + step as f32), 0.01 * f64::from(step));
            assert_eq!(edits.next_request(&scene, 1.0), None, "one is in flight");
        }
        edits.edited(first.request, 2, 1);
        let second = edits.next_request(&scene, 1.0).unwrap();
        assert_eq!(intensity_sent(&second), 30.0);
        assert_ne!(first.idempotency_key, second.idempotency_key);
    }

    #[test]
    fn batches_go_out_at_most_thirty_times_a_second() {
        let scene = scene(1);
        let mut edits = Edits::new(1);
        let mut sent = 0;
        for frame in 0..1000 {
            let now_s = f64::from(frame) * 0.001;
            edits.change(&scene, &lamp(), with_intensity(20.0 + frame as f32), now_s);
            if let Some(request) = edits.next_request(&scene, now_s) {
                sent += 1;
                edits.edited(request.request, 2 + sent, 1);
            }
        }
        assert!((20..=30).contains(&sent), "{sent}");
    }

    #[test]
    fn a_draft_is_shown_until_the_scene_has_caught_up() {
        let mut now = scene(1);
        let mut edits = Edits::new(1);
        edits.change(&now, &lamp(), with_intensity(20.0), 0.0);
        let request = edits.next_request(&now, 0.0).unwrap();
        assert!(edits.is_pending(&lamp()));
        edits.edited(request.request, 2, 1);
        assert_eq!(edits.value(&now, &lamp()), Some(with_intensity(20.0)), "the scene is still the old one");
        assert!(!edits.is_pending(&lamp()));
        // The scene of revision 2, in which someone else went on.
        now.revision = 2;
        now.lights[0].source = LightSource::Point { intensity: [7.0; 3], position: [0.0; 3] };
        edits.scene_arrived(2);
        assert_eq!(edits.value(&now, &lamp()), Value::in_scene(&now, &lamp()));
    }

    #[test]
    fn going_back_to_the_old_value_while_the_new_one_is_in_flight_is_an_edit() {
        let scene = scene(1);
        let original = Value::in_scene(&scene, &lamp()).unwrap();
        let mut edits = Edits::new(1);
        edits.change(&scene, &lamp(), with_intensity(20.0), 0.0);
        let first = edits.next_request(&scene, 0.0).unwrap();
        edits.change(&scene, &lamp(), original, 0.1);
        edits.edited(first.request, 2, 1);
        assert_eq!(intensity_sent(&edits.next_request(&scene, 1.0).unwrap()), 10.0);
    }

    #[test]
    fn a_refused_edit_returns_to_the_scene_and_says_why_at_its_editor() {
        let scene = scene(1);
        let mut edits = Edits::new(1);
        edits.change(&scene, &lamp(), with_intensity(-1.0), 0.0);
        let request = edits.next_request(&scene, 0.0).unwrap();
        let mut problem = Problem::new(ProblemKind::EditRefused, "negative");
        (problem.op_index, problem.field) = (Some(0), Some("intensity".into()));
        assert!(edits.refused(request.request, &problem));
        assert_eq!(edits.value(&scene, &lamp()), Value::in_scene(&scene, &lamp()));
        assert_eq!(edits.problem(&lamp()).unwrap().field.as_deref(), Some("intensity"));
        assert!(edits.problem(&Target::Environment).is_none());
        // The next change starts clean.
        edits.change(&scene, &lamp(), with_intensity(3.0), 5.0);
        assert!(edits.problem(&lamp()).is_none());
        assert_eq!(intensity_sent(&edits.next_request(&scene, 5.0).unwrap()), 3.0);
    }

    #[test]
    fn an_edit_names_only_what_changed() {
        let from = MaterialProperties::default();
        let to = MaterialProperties { roughness: 0.25, alpha_cutoff: Some(0.5), ..from };
        let target = Target::Material(Id::new("white").unwrap());
        let edit = edit_between(&target, &Value::Material(from), &Value::Material(to)).unwrap();
        let json = serde_json::to_string(&edit).unwrap();
        assert_eq!(json, r#"{"op":"set_material","material":"white","roughness":0.25,"alpha_cutoff":0.5}"#);
        let back = edit_between(&target, &Value::Material(to), &Value::Material(from)).unwrap();
        assert!(serde_json::to_string(&back).unwrap().contains(r#""alpha_cutoff":null"#));
        assert_eq!(edit_between(&target, &Value::Material(to), &Value::Material(to)), None);
    }

    #[test]
    fn a_lost_connection_repeats_what_was_in_flight_with_the_same_key() {
        let scene = scene(1);
        let mut edits = Edits::new(0xabc);
        edits.change(&scene, &lamp(), with_intensity(20.0), 0.0);
        let first = edits.next_request(&scene, 0.0).unwrap();
        edits.reconnected();
        assert_eq!(edits.next_request(&scene, 9.0).unwrap(), first);
        assert_eq!(edits.next_request(&scene, 9.0), None, "repeated once");
        assert_eq!(edits.value(&scene, &lamp()), Some(with_intensity(20.0)));
        edits.edited(first.request, 2, 2);
        assert_eq!(edits.value(&scene, &lamp()), Value::in_scene(&scene, &lamp()));
    }

    #[test]
    fn undo_takes_back_a_whole_drag_and_redo_brings_it_again() {
        let scene = scene(1);
        let original = Value::in_scene(&scene, &lamp()).unwrap();
        let mut edits = Edits::new(1);
        for step in 0..20 {
            edits.change(&scene, &lamp(), with_intensity(20.0 + step as f32), 0.016 * f64::from(step));
        }
        edits.change(&scene, &lamp(), with_intensity(99.0), 10.0);
        edits.undo();
        assert_eq!(edits.value(&scene, &lamp()), Some(with_intensity(39.0)));
        edits.undo();
        assert_eq!(edits.value(&scene, &lamp()), Some(original));
        assert!(!edits.can_undo() && edits.can_redo());
        edits.redo();
        edits.redo();
        assert_eq!(edits.value(&scene, &lamp()), Some(with_intensity(99.0)));
        edits.change(&scene, &lamp(), with_intensity(1.0), 20.0);
        assert!(!edits.can_redo());
    }

    #[test]
    fn every_queue_of_editing_has_an_end() {
        let scene = scene(1);
        let mut edits = Edits::new(1);
        for i in 0..10_000 {
            edits.change(&scene, &lamp(), with_intensity(20.0 + i as f32), f64::from(i));
            edits.command(
                Edit::RemoveLight(lumicast_protocol::RemoveLight { light: Id::new("x").unwrap() }),
                None,
            );
        }
        assert!(
            edits.undo.len() <= UNDO_MAX && edits.commands.len() <= COMMANDS_MAX && edits.drafts.len() == 1
        );
    }
}
