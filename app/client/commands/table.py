"""Every command by its name: where it is implemented, and its summary.

Commands of the client are in this package. Those of the service are named here, so that a shop-floor PC's `gridpose`
says what they need; `app.cli` implements them.
"""

from __future__ import annotations

GROUPS = {
    "keys": "Create, list and revoke API keys, with or without a running service.",
    "schema": "Show the schema of the database, and downgrade it before an older version is installed.",
    "robots": "Make, show and delete the robots of a service; write an identified one as a file; plan an "
    "identification.",
    "robots plan": "Plan a measurement before the robot moves: an identification, or a test of repeatability.",
    "robots events": "What was done to a robot, such as maintenance.",
    "poses": "The commanded poses of a session.",
    "hand-eye": "Where the camera sits on the robot's flange, and the target in its base.",
    "camera-poses": "The camera's pose in every image of a session.",
    "measured-poses": "Poses that a laser tracker or another instrument measured.",
    "targets": "Print a target and check a printed one; make, show and delete those of a service.",
    "measurements": "Show what came of images, and correct what was said about them.",
    "sessions": "Make, show, change and delete the sessions of a service, compute them again, and archive them.",
    "qualifications": "Records of what known lengths showed of a set-up.",
    "webhooks": "Addresses that a service notifies of what happens: make, list, test and delete them.",
    "report": "Stored reports of sessions: make, list, save and verify them.",
}
"""Groups of commands, in the order of `--help`."""

CLIENT = {
    "upload": (
        ".images.upload:upload",
        "Send a folder's images to a session, once each; repeat it to continue after an interruption.",
    ),
    "watch": (
        ".images.watch:watch",
        "Send each image that appears in a folder, once, until stopped; it may run for months.",
    ),
    "login": (
        ".login:login",
        "Keep an API key for a service, so that commands and programs of this user need no other.",
    ),
    "logout": (".login:logout", "Forget the API key that was kept for a service."),
    "qualify": (
        ".sessions.qualification:qualify",
        "Compare known lengths between poses of a session with what it measured of them, and store the result.",
    ),
    "qualifications list": (
        ".sessions.qualification:show_list",
        "List qualifications by known lengths, those of deleted sessions too.",
    ),
    "report create": (
        ".reports.stored:create",
        "Make a report of a session as it is now; it is stored, signed, and never changes.",
    ),
    "report list": (".reports.stored:show_list", "List stored reports, those of deleted sessions too."),
    "report show": (".reports.stored:show", "Print what a report is, and the hashes of its forms."),
    "report fetch": (
        ".reports.stored:fetch",
        "Save a form of a report, and its detached signature alongside it.",
    ),
    "webhooks create": (
        ".webhooks.stored:create",
        "Make a webhook: an address that notices are sent to; prints its secret, this once, as the last line.",
    ),
    "webhooks list": (".webhooks.stored:show_list", "List the webhooks of a service, without their secrets."),
    "webhooks delete": (".webhooks.stored:delete", "Delete webhooks with their journals."),
    "webhooks test": (
        ".webhooks.journal:test",
        "Send a notice to a webhook, and wait for what comes of it; ends with 1 where it was not delivered.",
    ),
    "webhooks deliveries": (
        ".webhooks.journal:deliveries",
        "List what was sent to a webhook, or waits to be, and why it was not delivered.",
    ),
    "webhooks redeliver": (
        ".webhooks.journal:redeliver",
        "Send deliveries of a webhook again; without ids, all that failed.",
    ),
    "robots create": (
        ".robots.creation:create",
        "Make a robot with its nominal Denavit-Hartenberg parameters: by joint, from a CSV or URDF, or by its model.",
    ),
    "robots change": (
        ".robots.creation:change",
        "Change what is stated of a robot; joints are given whole.",
    ),
    "robots compensate": (
        ".robots.compensation:compensate",
        "Correct commanded poses by what a session identified of the robot, from file to file.",
    ),
    "robots list": (".robots.stored:show_list", "List the robots of a service."),
    "robots events add": (
        ".robots.events:add",
        "Note something done to a robot: its history shows it, charts mark it, and alarms name what came before them.",
    ),
    "robots events list": (".robots.events:show_list", "List what was done to a robot, oldest first."),
    "robots events delete": (".robots.events:delete", "Delete events that were noted in error."),
    "robots show": (".robots.stored:show", "Print a robot as the service answers it."),
    "robots delete": (".robots.stored:delete", "Delete robots that no session names."),
    "hand-eye export": (
        ".exports.hand_eye:export",
        "Write a session's hand-eye calibration as YAML, JSON or ROS static transforms, with its uncertainty.",
    ),
    "camera-poses export": (
        ".exports.camera_poses:export",
        "Write the camera's pose in every image of a session: mm and quaternion x, y, z, w, in the target's frame.",
    ),
    "measured-poses import": (
        ".measured_poses.command:import_poses",
        "Send poses measured by a laser tracker or another instrument to a session; repeating changes nothing.",
    ),
    "measured-poses delete": (
        ".measured_poses.deletion:delete",
        "Delete poses that another instrument measured: those of a pose, of a cycle, of both, or all.",
    ),
    "targets create": (
        ".targets.creation:create",
        "Make a target: what is printed, how many grid points it has, and their distance.",
    ),
    "targets list": (".targets.stored:show_list", "List the targets of a service."),
    "targets show": (".targets.stored:show", "Print a target as the service answers it."),
    "targets change": (
        ".targets.changes:change",
        "Change a target's name, or what is known of its print: its pitch's uncertainty, its kind, its certificate.",
    ),
    "targets delete": (
        ".targets.stored:delete",
        "Delete targets that no session and no measurement refers to.",
    ),
    "measurements list": (
        ".measurements.listing:show_list",
        "List a session's measurements with their ids, why they failed, and why they are excluded.",
    ),
    "measurements show": (
        ".measurements.listing:show",
        "Print a measurement as the service answers it.",
    ),
    "measurements correct": (
        ".measurements.changes:correct",
        "Correct the pose, cycle, burst index, focus group or joint angles of an image, in all of its measurements.",
    ),
    "measurements exclude": (
        ".measurements.changes:exclude",
        "Exclude measurements from analyses, which list them with the reason.",
    ),
    "measurements include": (
        ".measurements.changes:include",
        "Let measurements count again that were excluded from analyses.",
    ),
    "measurements delete": (
        ".measurements.changes:delete",
        "Delete measurements with their results, and originals that no other measurement holds.",
    ),
    "measurements retry": (
        ".measurements.changes:retry",
        "Compute measurements again; their results stay until others replace them.",
    ),
    "sessions create": (
        ".sessions.creation:create",
        "Begin a session: one camera looking at one or more targets.",
    ),
    "sessions import": (
        ".sessions.dataset:import_dataset",
        "Send a dataset of hand-eye calibration in another program's layout: its images, and the robot's pose at each.",
    ),
    "sessions list": (
        ".sessions.listing:show_list",
        "List the sessions of a service, with how many images were measured, and how many give a pose by themselves.",
    ),
    "sessions show": (".sessions.listing:show", "Print a session as the service answers it."),
    "sessions budget": (
        ".sessions.budget:budget",
        "Show the uncertainty budget (GUM) of a session's RP_l, noise floor, AP and AD.",
    ),
    "sessions joint-noise": (
        ".sessions.joint_noise:joint_noise",
        "Show the noise of a robot's joints by the scatter of repeated poses, and the repeatability it predicts.",
    ),
    "sessions next-view": (
        ".sessions.next_view:next_view",
        "Suggest the views that would make a session's camera, hand-eye calibration or robot most certain.",
    ),
    "sessions change": (
        ".sessions.changes:change",
        "Change a session's targets, robot, name, camera mount, lens or conditions.",
    ),
    "sessions reprocess": (
        ".sessions.changes:reprocess",
        "Compute a session's failed measurements again, or all; results stay until others replace them.",
    ),
    "sessions export-camera": (
        ".sessions.camera_file:export_camera",
        "Write a session's camera for OpenCV, ROS, Kalibr or mrcal, with the largest error of the conversion.",
    ),
    "sessions delete": (".sessions.changes:delete", "Delete a session with everything in it."),
    "poses load": (
        ".sessions.poses:load",
        "Store the commanded poses of a file in a session, all or none; a pose that is there is replaced whole.",
    ),
}
"""Commands of the client: module relative to this package, function, and summary."""

SERVICE = {
    "serve": "Run the service: HTTP, and GRIDPOSE_WORKERS worker processes (default: one a core).",
    "worker": "Compute queued images without serving HTTP.",
    "doctor": "Check this installation and its data folder, with advice for each problem found.",
    "backup": "Copy database, originals and pepper, all of one moment, while the service runs.",
    "restore": "Restore a backup into an empty data folder and an empty database.",
    "migrate-to": "Move this installation to a PostgreSQL database, to an S3 bucket, or to both, while nothing runs.",
    "demo": "Run a small rendered session with known truth through the real service, and compare.",
    "keys create": "Create a key and print it, this once, as the last line.",
    "keys list": "Show names, scopes and dates of all keys; never the keys themselves.",
    "keys revoke": "Revoke a key, at once and permanently.",
    "schema show": "Show the database's schema, this version's, and the earlier ones it can be downgraded to.",
    "schema downgrade": "Downgrade the database to an earlier schema, for an older version; a copy is made first.",
    "sessions archive": "Write a session with everything in it to one signed file: images, rows, results, reports.",
    "sessions restore": "Restore a session from its archive, with its ids, byte for byte as it was.",
    "report compare": "Compare the figures of two reports, the later with the earlier, with intervals and a conclusion "
    "in words.",
    "robots history": "Show RP, AP, noise floor, parameters and cameras of a robot over its reports, and what changed "
    "lastingly.",
    "report verify": "Check a saved report by its signature, or compute a stored one anew and compare every figure.",
    "robots export": "Write a session's identified robot as URDF, Robotics Toolbox model, YAML or CSV.",
    "robots plan dh": "Predict the uncertainty of every DH parameter for a set of poses, and suggest the poses that "
    "help most.",
    "robots plan iso9283": "Write the standard's test poses, and predict floor, intervals and verdicts of the session.",
    "targets print": "Draw a target at true scale as PDF or SVG, with rulers along two sides and its own id.",
    "targets check": "Determine from photographs how a print differs from its description: stretch, squareness, "
    "flatness.",
}
"""Commands of the service, with their summaries."""
