# Texts of light.js.
light-title = Light and focus
light-what = Make edges sharp and let nothing clip: first the light, then the rings of the lenses, while you watch what it costs.
light-thing = First put a board or a part where parts will lie: light and focus are judged by it, and an empty scene would give wrong advice.
light-thing-is = It is there
light-thing-there = Light and focus are judged by what lies there.
light-thing-gone = Nothing is there any more
light-take = Take the cell to set exposure and gain: its cameras are needed.
light-no-settings = Nothing can be set here: the camera reports no limits, or is not there.
light-no-figures = Figures come with the live pictures.
settings-left = Settings of the left camera
settings-right = Settings of the right camera
setting-exposure-us = Exposure
setting-gain-db = Gain
light-head = Light
light-figures = { $clipped } % clipped, { $dark } % too dark, noise { $noise } and contrast { $contrast } grey values
advice-good = Exposure is good.
advice-less-light = Something is clipped, and cannot be measured: less exposure or less light.
advice-more-light = Too dark: longer exposure, or more light.
advice-light-for-gain = Noisy: less gain, and longer exposure or more light instead.
advice-take = Set { $exposure } µs
legend-clipped = clipped
legend-dark = too dark
light-copy = Same settings for the right camera
focus-title = Focus
focus-none = No edges to judge: put a board or a part there.
focus-now = Edges are { $now } px wide
focus-best = best { $best } px
focus-cost =
    { $isFree ->
        [0] This costs nothing in sigma Z.
       *[other] This costs +{ $percent } % in sigma Z.
    }
focus-reset = Forget the best
