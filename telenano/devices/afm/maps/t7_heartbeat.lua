-- telenano heartbeat: retracts the stage when its host falls silent. Runs on a LabJack T7 or T8 (Lua 5.1, numbers are
-- single floats). The host writes a new beat with every request; 0 means that nobody drives.
local VERSION = 1
local F32, STEP_MS = 3, 5
local BEAT, LIMIT_MS, SAFE_V, OUTPUT, RUNNING, TRIPS = 46000, 46002, 46004, 46006, 46008, 46010
local last, silent_ms, tripped = 0, 0, false

LJ.IntervalConfig(0, STEP_MS)
while true do
  if LJ.CheckInterval(0) then
    local beat = MB.R(BEAT, F32)
    if beat == 0 then
      silent_ms, tripped = 0, false
    elseif beat ~= last then
      silent_ms = 0
    else
      silent_ms = silent_ms + STEP_MS
    end
    last = beat
    if silent_ms > MB.R(LIMIT_MS, F32) and not tripped then
      tripped = true
      MB.W(TRIPS, F32, MB.R(TRIPS, F32) + 1)
    end
    if tripped then
      -- again and again: what a host that is late sends goes to the tip for one step at most
      MB.W(MB.R(OUTPUT, F32), F32, MB.R(SAFE_V, F32))
    end
    MB.W(RUNNING, F32, VERSION)
  end
end
