# Texts of calibrate.js.
calibrate-title = Kalibrieren
calibrate-what = Halten Sie eine Kalibriertafel vor beide Kameras, an verschiedenen Orten und verschieden geneigt. edged sagt, welche Ansicht am meisten hilft, und wann es genug ist.
calibrate-new = Andere Kalibrierung beginnen
calibrate-nameless = { $id }, noch ohne Tafel
calibrate-begun-views =
    { $views ->
        [one] eine Ansicht
       *[other] { $views } Ansichten
    }
calibrate-discard-what = Alle ihre Ansichten sind dann weg. Die Kalibrierung in Gebrauch bleibt.
calibrate-board = Tafel:
calibrate-looking = Halten Sie die Tafel vor beide Kameras, dorthin, wo Teile liegen werden: sie wird erkannt.
sigma-unknown =
    { $used ->
        [0] Zeigen Sie beiden Kameras die Tafel.
        [one] Eine Ansicht. Die erste Zahl kommt mit dreien.
       *[other] { $used } Ansichten. Die erste Zahl kommt bald.
    }
sigma-now = ein Punkt hier: jetzt ±{ $now } µm
sigma-then = ±{ $next } mit dieser Ansicht
sigma-goal = Ziel ±{ $goal }
sigma-again = rechnet mit der letzten Ansicht …
sigma-reached = erreicht
sigma-on = weiter
sigma-more =
    { $count ->
        [one] noch etwa eine
       *[other] noch etwa { $count }
    }
ghost-here = hier
ghost-share = { $percent } % am gestrichelten Ort
seen-whole = Die ganze Tafel ist zu sehen.
seen-clipped = Teile der Tafel sind übersteuert: weniger Licht.
auto-start = Ansichten von selbst aufnehmen
auto-stop = Nicht mehr von selbst
view-take = Diese Ansicht jetzt
sound-on = Ton ist an
sound-off = Ton ist aus
ghost-where = Nächste Ansicht:
at-upper-left = oben links
at-upper-middle = oben in der Mitte
at-upper-right = oben rechts
at-middle-left = links
at-middle-middle = in der Mitte
at-middle-right = rechts
at-lower-left = unten links
at-lower-middle = unten in der Mitte
at-lower-right = unten rechts
far-near = nah
far-middle = in mittlerem Abstand
far-far = fern
far-any = in beliebigem Abstand
tilt-square = gerade vor der linken Kamera
tilt-right-near = rechte Seite zu den Kameras
tilt-left-near = linke Seite zu den Kameras
tilt-lower-away = untere Seite von den Kameras weg
tilt-upper-away = obere Seite von den Kameras weg
missing-dark = Keine Tafel: das Bild ist zu dunkel.
missing-bright = Keine Tafel: das Bild ist zu hell.
missing-not-found = Es ist keine ganze Tafel zu sehen.
waits-no-board = Wartet auf die Tafel.
waits-no-board-left = Die linke Kamera sieht nicht die ganze Tafel.
waits-no-board-right = Die rechte Kamera sieht nicht die ganze Tafel.
waits-moving = Wartet, bis die Tafel ruhig ist.
waits-same = Diese Ansicht gibt es schon: bringen Sie die Tafel an den gestrichelten Ort.
waits-elsewhere = Bringen Sie die Tafel an den gestrichelten Ort.
waits-busy = Einen Augenblick.
waits-board-unknown = Die Tafel ist noch nicht erkannt.
why-left-out = Von Hand weggelassen.
why-not-found = Die Tafel wurde nicht gefunden.
why-excluded = Sie widerspricht den anderen Ansichten.
views-title =
    { $count ->
        [one] Eine Ansicht
       *[other] { $count } Ansichten
    }
view-rms = rms { $rms } px
view-new = wird gemessen
view-heldout = zurückgehalten { $heldout } px
view-remove = Weglassen
view-remove-name = Ansicht { $name } weglassen
view-taken = Ansicht { $name } aufgenommen.
view-refused = Ansicht { $name } ist nicht brauchbar: { $why }
view-removed = Ansicht { $name } ist weggelassen.
undo = Rückgängig
undone = Rückgängig gemacht.
verdict-good = Diese Kalibrierung ist gut.
verdict-usable = Diese Kalibrierung ist brauchbar.
verdict-repeat = Noch nicht gut genug: nehmen Sie mehr Ansichten auf und lösen Sie nochmals.
redo = Wiederholen
redone = Wiederholt.
solve-title = Lösen
solve-what =
    { $used ->
        [one] Eine Ansicht wird benutzt.
       *[other] { $used } Ansichten werden benutzt.
    } Jede wird auch einmal zurückgehalten und aus den anderen vorhergesagt.
solve-start = Lösen
solve-again = Nochmals lösen
solve-running = Wird gelöst
solve-cancel = Abbrechen
solve-done = Gelöst.
solve-failed = Es ließ sich nicht lösen:
solve-cancelled = Abgebrochen. Alle Ansichten sind noch da.
solved-rms = Restfehler, rms
solved-heldout = Zurückgehalten, rms
solved-sigma = Ein Punkt im Messraum
solved-moved = Punkte verschoben gegen die Kalibrierung davor um
solved-report = Bericht (neues Fenster)
activate = Diese Kalibrierung benutzen
activate-title = Diese Kalibrierung benutzen?
activate-note = Kalibrierung, ± { $sigma } µm
activate-what = Sie wird eine eigene Freigabe. Was auch schiefgeht, die alte bleibt; zurück geht es mit einem Schritt in der Liste der Freigaben.
activated = In Gebrauch, als Freigabe { $number }.
other-board = Die Bilder zeigen eine andere Tafel als die angegebene: { $board }. Zählen Sie, wo vier Felder sich treffen, nicht die Felder; beginnen Sie mit der richtigen neu.
problem-calibration-few-views = Die Tafel ist in { $found } von { $pairs } Ansichten in beiden Bildern ganz zu sehen; { $least } braucht es, zwanzig sind gut.
problem-calibration-parallel = Die Tafel ist in allen Ansichten gleich geneigt: Brennweite und Abstand lassen sich so nicht trennen. Neigen Sie sie um 20° bis 40°, jedes Mal anders.
problem-calibration-one-place = Beide Bilder kommen von einem Ort: ist es zweimal dieselbe Kamera?
problem-calibration-swapped = Links und rechts sind vertauscht: winken Sie im Schritt „Kameras“ vor der linken Kamera. Auch Kameras, die kopfüber hängen, sehen so aus.
problem-calibration-moving = Links und rechts zeigen die Tafel an zwei Orten: halten Sie sie ruhig, bis beide Bilder da sind, und lassen Sie beide Kameras von einem Signal auslösen.
problem-calibration-contradiction = Die Ansichten widersprechen sich: hat sich die Tafel oder eine Kamera zwischen den Aufnahmen bewegt?
problem-calibration-camera-moved = Eine Kamera wurde zwischen den Ansichten { $before } und { $after } bewegt. Ziehen Sie fest, was lose ist, und nehmen Sie die Ansichten neu auf.
problem-calibration-undetermined = Diese Ansichten lassen die Objektive offen: neigen Sie die Tafel um 20° bis 40°, jedes Mal anders, und füllen Sie die Bilder.
problem-calibration-other-board = Die Bilder zeigen eine andere Tafel ({ $seen }) als die angegebene ({ $stated }). Zählen Sie, wo vier Felder sich treffen, nicht die Felder; beginnen Sie mit der richtigen neu.
