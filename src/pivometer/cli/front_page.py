"""What ``pivometer`` says of itself before anything else is imported.

The page is text, not made from the commands, so that it is there at once;
a test holds it against the commands.
"""

FRONT_PAGE = """\
Example:  pivometer measure my-session
          reads the pictures in my-session, prints where the robot pivots, how
          far it misses and what was rejected, and writes a report:
          my-session/results/report.html
          No pictures yet?  pivometer demo

Usage: pivometer COMMAND

Measure the remote center of motion (RCM) of a surgical robot with two cameras
or more.

Commands:
  demo       Render a small session, measure it and write the report.
  simulate   Render a session whose truth is known, in DIR/truth.json.
  calibrate  Calibrate the cameras of a session from its board views.
  measure    Measure the RCM of a session and write the report.
  app        Lead through a measurement in the browser of this computer.
  export     Write a calibrated rig in the format of another program.
  target     Draw a calibration board to print, as PDF or SVG.
  solve      Solve for the RCM of lines from a CSV file.
  pivot      Find the pivot of a tracked instrument: of its tip, or of its axis.
  check      Decide whether a robot's RCM error keeps a limit.
  figures    Write a result's figures (SVG, PNG) and tables (CSV).
  compare    Say whether results differ by more than chance explains.
  history    Show how results change over time, with limits.
  verify     Verify that a report says what its inputs say.
  plan       Say what a measurement will be good for, before it is made.
  schema     Print the JSON Schema of result.json.

  pivometer COMMAND --help says more, with an example.
  pivometer --version prints the version.

Exit codes: 0 done, 2 wrong usage or configuration, 3 data unfit for an answer.
"""
