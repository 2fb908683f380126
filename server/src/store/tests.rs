use super::*;
use lumicast_protocol::EditBatch;

fn record(revision: u64) -> Record {
    let json = format!(r#"[{{"op":"remove_light","light":"lamp {revision}"}}]"#);
    let edits = EditBatch::from_json(json.as_bytes()).unwrap().edits;
    Record { revision, seconds_since_epoch: 0.5, idempotency_key: None, digest: None, edits }
}

fn id(text: &str) -> SceneId {
    SceneId::new(text).unwrap()
}

fn log_path(dir: &Path) -> PathBuf {
    dir.join("scenes/box/edits-1.log")
}

/// A store with one scene and revisions 2 to 4, closed again.
fn written() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(dir.path()).unwrap();
    let mut scene = store.create(&id("box"), "Box", &Base::Glb(b"glb".to_vec())).unwrap();
    for revision in 2..=4 {
        scene.append(&Encoded::new(&record(revision)).unwrap()).unwrap();
    }
    dir
}

#[test]
fn what_was_appended_is_read_back_in_order() {
    let dir = written();
    let store = Store::open(dir.path()).unwrap();
    assert_eq!(store.scenes().unwrap(), [id("box")]);
    let (_, stored) = store.load(&id("box")).unwrap();
    assert_eq!(stored.base, Base::Glb(b"glb".to_vec()));
    assert_eq!(stored.records, [record(2), record(3), record(4)]);
    assert_eq!((stored.base_revision, stored.warning), (1, None));
}

#[test]
fn a_log_cut_at_any_byte_keeps_every_whole_record() {
    let dir = written();
    let whole = fs::read(log_path(dir.path())).unwrap();
    let record_bytes = (whole.len() - 8) / 3;
    for length in 8..whole.len() {
        fs::write(log_path(dir.path()), &whole[..length]).unwrap();
        let store = Store::open(dir.path()).unwrap();
        let (mut scene, stored) = store.load(&id("box")).unwrap();
        let kept = (length - 8) / record_bytes;
        assert_eq!(stored.records.len(), kept, "cut at {length}");
        assert_eq!(stored.warning.is_some(), (length - 8) % record_bytes != 0);
        // The next batch goes where the torn one was.
        scene.append(&Encoded::new(&record(kept as u64 + 2)).unwrap()).unwrap();
        let (_, stored) = store.load(&id("box")).unwrap();
        assert_eq!((stored.records.len(), stored.warning), (kept + 1, None));
    }
}

#[test]
fn a_zeroed_or_garbled_tail_is_cut_and_damage_before_whole_records_refuses() {
    let dir = written();
    let whole = fs::read(log_path(dir.path())).unwrap();
    let store = Store::open(dir.path()).unwrap();
    for tail in [vec![0; 4096], vec![0xff; 100], whole[8..40].to_vec()] {
        fs::write(log_path(dir.path()), [&whole[..], &tail].concat()).unwrap();
        let (_, stored) = store.load(&id("box")).unwrap();
        assert_eq!(stored.records.len(), 3);
        assert!(stored.warning.is_some());
    }
    for at in [8, 12, 20] {
        let mut flipped = whole.clone();
        flipped[at] ^= 1;
        fs::write(log_path(dir.path()), flipped).unwrap();
        assert!(matches!(store.load(&id("box")), Err(StoreError::Damaged { .. })), "byte {at}");
    }
}

#[test]
fn folding_keeps_revision_and_keys_and_drops_the_old_files() {
    let dir = written();
    let store = Store::open(dir.path()).unwrap();
    let (mut scene, _) = store.load(&id("box")).unwrap();
    let keys = vec![KeptKey { key: "k".into(), digest: 7, revision: 3 }];
    scene.fold(&Base::Glb(b"folded".to_vec()), 4, keys.clone()).unwrap();
    scene.append(&Encoded::new(&record(5)).unwrap()).unwrap();
    let (_, stored) = store.load(&id("box")).unwrap();
    assert_eq!((stored.base, stored.base_revision, stored.keys), (Base::Glb(b"folded".to_vec()), 4, keys));
    assert_eq!(stored.records, [record(5)]);
    let mut files: Vec<_> = fs::read_dir(dir.path().join("scenes/box"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    files.sort();
    assert_eq!(files, ["base-4.glb", "edits-4.log", "scene.json"]);
}

#[test]
fn one_folder_has_one_server() {
    let dir = tempfile::tempdir().unwrap();
    let _first = Store::open(dir.path()).unwrap();
    assert!(matches!(Store::open(dir.path()), Err(StoreError::InUse { .. })));
}

#[test]
fn a_removed_scene_is_gone_and_a_half_made_one_is_ignored() {
    let dir = written();
    let store = Store::open(dir.path()).unwrap();
    fs::create_dir(dir.path().join("scenes/half")).unwrap();
    assert_eq!(store.scenes().unwrap(), [id("box")]);
    store.remove(&id("box")).unwrap();
    assert!(store.scenes().unwrap().is_empty());
}

/// A scene that is kept is never made anew over itself: its edits would be gone.
#[test]
fn creating_over_a_kept_scene_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let store = Store::open(dir.path()).unwrap();
    let id = SceneId::new("demo").unwrap();
    let base = Base::Builtin("cornell-box".into());
    drop(store.create(&id, "Demo", &base).unwrap());
    assert!(matches!(store.create(&id, "Demo", &base), Err(StoreError::Exists { .. })));
    assert!(store.load(&id).is_ok());
}
