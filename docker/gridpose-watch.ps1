# A scheduled task on a Windows shop-floor PC that watches a folder from the start of the PC on, without a login.
# Run once in a PowerShell as administrator. Change the six values first; $User is who did `gridpose login`.
$User = "$env:USERDOMAIN\$env:USERNAME"
$Program = "$HOME\gridpose\Scripts\gridpose.exe"
$Folder = "D:\images"
$Session = "Cell 7"
$Url = "http://measuring-pc:8000"
$State = "$HOME\gridpose\state.json"

$Options = "watch `"$Folder`" --session `"$Session`" --url $Url --state-file `"$State`""
$Action = New-ScheduledTaskAction -Execute $Program -Argument $Options
# The second trigger starts it again within five minutes, however often and for whatever reason it has ended; while it
# runs, nothing is started. (A task restarts itself after a failure 255 times at most, and not after an end.)
$Triggers = @(
    (New-ScheduledTaskTrigger -AtStartup),
    (New-ScheduledTaskTrigger -Once -At (Get-Date) -RepetitionInterval (New-TimeSpan -Minutes 5))
)
$Settings = New-ScheduledTaskSettingsSet -ExecutionTimeLimit ([TimeSpan]::Zero) -MultipleInstances IgnoreNew `
    -StartWhenAvailable -AllowStartIfOnBatteries -DontStopIfGoingOnBatteries
# With a password: without one (S4U) a task reaches neither network shares nor the user's credential store.
$Login = Get-Credential -UserName $User -Message "Windows password of the user that the task runs as"
Register-ScheduledTask -TaskName "Gridpose watch" -Action $Action -Trigger $Triggers -Settings $Settings `
    -User $Login.UserName -Password $Login.GetNetworkCredential().Password -Force
Start-ScheduledTask -TaskName "Gridpose watch"
